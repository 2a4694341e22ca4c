"""Pictures of an instrument at work, made up: motion, breathing, light and lag are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from surg_recording.video.image_motion import HEIGHT, WIDTH

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


def smooth(rng: np.random.Generator, shape: tuple[int, int], size: int) -> Array:
    """A random texture with grains of about this size, mean 0 and deviation 1."""
    rows, columns = shape
    field = np.fft.rfft2(rng.standard_normal(shape))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(rows), np.fft.rfftfreq(columns), indexing="ij"))
    field *= np.exp(-((f * size) ** 2))
    texture = np.fft.irfft2(field, s=shape)
    return np.asarray((texture - texture.mean()) / texture.std())


def wander(rng: np.random.Generator, t: Array, speed: float = 0.03) -> Array:
    """(N, 3) a tip that goes from place to place, with rests, within ± 25 mm [m]."""
    place, now = np.zeros(3), 0.0
    p = np.zeros((len(t), 3))
    while now < t[-1] + 1.0:
        if rng.random() < 0.3:
            until, goal = now + rng.uniform(0.2, 1.5), place
        else:
            goal = rng.uniform(-0.025, 0.025, 3)
            until = now + max(0.25, float(np.linalg.norm(goal - place)) / speed)
        share = np.clip((t - now) / (until - now), 0.0, 1.0)
        share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        here = t >= now
        p[here] = place + share[here, None] * (goal - place)
        place, now = goal, until
    return p


def tremor(rng: np.random.Generator, t: Array, size: float = 20e-6) -> Array:
    """(N, 3) what a resting tip still does [m]."""
    return np.asarray(size * np.sin(2 * np.pi * 8.0 * t[:, None] + rng.uniform(0, 6, 3)))


@dataclasses.dataclass
class Scene:
    """What is in view."""

    seed: int = 0
    breathing: float = 2.0
    """How far the tissue moves [pixels of the small picture]."""
    breaths: float = 0.25
    """Per second."""
    flicker: float = 0.1
    """How much the light varies, as a share of it."""
    noise: float = 1.5
    """Standard deviation [grey levels]."""
    visible: bool = True
    """Whether the instrument is in view."""

    def pictures(self, t: Array, p: Array) -> list[Picture]:
        """The pictures at these times of a tip at these places.

        Args:
            t: (N,) [s].
            p: (N, 3) [m]; x to the right, y down, z away; the picture is 80 mm wide.
        """
        rng = np.random.default_rng(self.seed + 10_000)
        tissue = 110.0 + 25.0 * smooth(rng, (HEIGHT + 16, WIDTH + 16), 5)
        glow = 1.0 + 0.3 * smooth(rng, (HEIGHT, WIDTH), 60)
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
        phase = rng.uniform(0, 6)
        found = []
        for now, place in zip(t, p, strict=True):
            shift = self.breathing * np.sin(2 * np.pi * self.breaths * now + phase)
            picture = _shifted(tissue, 8.0 + shift, 8.0 + 0.5 * shift)
            if self.visible:
                self._instrument(picture, rows, columns, place)
            light = 1.0 + self.flicker * np.sin(2 * np.pi * 0.7 * now + phase)
            picture = picture * light * glow + self.noise * rng.standard_normal(picture.shape)
            found.append(np.clip(picture, 0, 255).astype(np.uint8))
        return found

    @staticmethod
    def _instrument(picture: Array, rows: Array, columns: Array, place: Array) -> None:
        """A bright shaft from the upper right corner to the tip, dark at its end."""
        scale = WIDTH / 0.080 * (1.0 - place[2] / 0.12)
        tip = np.array([WIDTH / 2 + scale * place[0], HEIGHT / 2 + scale * place[1]])
        away = np.array([WIDTH * 1.1, -HEIGHT * 0.3]) - tip
        away /= np.linalg.norm(away)
        along = (columns - tip[0]) * away[0] + (rows - tip[1]) * away[1]
        across = np.abs((columns - tip[0]) * -away[1] + (rows - tip[1]) * away[0])
        shaft = np.clip(5.0 - across, 0, 1) * np.clip(along + 0.5, 0, 1)
        colour = np.where(along < 9.0, 60.0, 190.0)
        picture += shaft * (colour - picture)


def _shifted(texture: Array, down: float, right: float) -> Array:
    """The part of a texture that is seen when it has moved by parts of a pixel."""
    i, j = int(down), int(right)
    a, b = down - i, right - j
    part = [texture[i + m : i + m + HEIGHT, j + n : j + n + WIDTH] for m in (0, 1) for n in (0, 1)]
    return np.asarray(
        (1 - a) * (1 - b) * part[0]
        + (1 - a) * b * part[1]
        + a * (1 - b) * part[2]
        + a * b * part[3]
    )
