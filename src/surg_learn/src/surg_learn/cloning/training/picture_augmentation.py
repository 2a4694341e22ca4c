"""How pictures vary while the eye is trained: light, colour, smoke, dirt, what is in front, pose.

Used by `keypoint_training.py` and `train_cloned.py`. A policy that has seen only one light and one
pose of the endoscope needs that light and that pose. All but the width of the blur, which is one
for a batch, is drawn for each picture, with PyTorch, on its device.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Looks:
    """How much pictures vary; chances are for each picture."""

    colour: float = 0.12
    """Standard deviation of each colour's random gain."""
    grain: float = 4.0
    """Standard deviation of the random noise of pixels [grey levels]."""
    dark: float = 0.4
    """Chance of another light; its share is drawn from `LIGHT`."""
    smoke: float = 0.2
    """Chance of a bright veil, uneven over the picture."""
    dirt: float = 0.2
    """Chance of a soft, nearly opaque spot."""
    bar: float = 0.15
    """Chance of something straight in front."""
    blur: float = 0.2
    """Chance of a picture out of focus."""
    moved: float = 0.5
    """Chance of a picture that is shifted, turned and scaled."""


LIGHT = (0.2, 1.3)
"""Smallest and largest light; equally likely in its logarithm."""
VEIL, SPOT, WIDTH = (0.1, 0.6), (0.05, 0.15), (0.04, 0.12)
"""Share that a veil hides at most; radius of a spot and width of a bar [picture sides]."""
FOCUS = (0.3, 1.5)
"""Standard deviation of a blur [px of the input]."""
SHIFT, TURN, SCALE = 0.3, 0.14, 0.1
"""Largest shift [half picture heights], turn [rad] and change of the scale."""


class Varied:
    """Draws variants of pictures.

    Args:
        torch: The module.
        side: Of the pictures [px].
        looks: How much.
        inside: (side, side) whether a pixel lies in the endoscope's round picture.
        seed: Of everything drawn.
        device: Of the results.
    """

    def __init__(
        self, torch: Any, side: int, looks: Looks, inside: Array, seed: int, device: str
    ) -> None:
        self._torch, self._looks, self._side = torch, looks, side
        self._rng = np.random.default_rng([seed, 1])
        self._device = device
        self._inside = self._there(inside.astype(np.float32))
        line = np.linspace(-1, 1, side, dtype=np.float32)
        self._down, self._right = (self._there(a) for a in np.meshgrid(line, line, indexing="ij"))

    def _there(self, array: Array) -> Any:
        return self._torch.from_numpy(np.ascontiguousarray(array, np.float32)).to(self._device)

    def _drawn(self, low: float, high: float, n: int, *more: int) -> Any:
        return self._there(self._rng.uniform(low, high, (n, *(more or (1, 1, 1)))))

    def __call__(self, views: Array, marks: Array) -> tuple[Any, Array]:
        """Variants of pictures and of the places in them.

        Args:
            views: (B, side, side, 3), uint8.
            marks: (B, P, 2) places, down and right, -1 to 1.

        Returns:
            (B, 3, side, side) float32 grey levels, and (B, P, 2).
        """
        x, marks = self._moved(self._there(views.transpose(0, 3, 1, 2)), marks)
        return self.dressed(x), marks

    def dressed(self, x: Any) -> Any:
        """Other light, dirt and noise on pictures (B, 3, side, side) of this device."""
        looks, chosen = self._looks, self._rng.random
        for chance, change in (
            (looks.bar, self._bar),
            (looks.dirt, self._dirt),
            (looks.smoke, self._smoke),
            (looks.dark, self._dark),
            (looks.blur, self._blur),
        ):
            rows = np.flatnonzero(chosen(len(x)) < chance)
            if len(rows):
                x[rows] = change(x[rows])
        gain = 1.0 + looks.colour * self._rng.standard_normal((len(x), 4, 1, 1))
        x = x * self._there(gain[:, :1] * gain[:, 1:])
        noise = self._torch.randn(x.shape, device=self._device)
        return (x + looks.grain * noise).clamp(0.0, 255.0)

    def _moved(self, x: Any, marks: Array) -> tuple[Any, Array]:
        """Shifted, turned and scaled; what comes in from outside is black."""
        n, rng, F = len(x), self._rng, self._torch.nn.functional
        on = (rng.random(n) < self._looks.moved).astype(float)
        turn, scale = TURN * on * rng.uniform(-1, 1, n), 1 + SCALE * on * rng.uniform(-1, 1, n)
        shift = SHIFT * on[:, None] * rng.uniform(-1, 1, (n, 2))
        c, s = scale * np.cos(turn), scale * np.sin(turn)
        # Where a pixel (right, down) comes from: A pixel + shift.
        A = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
        theta = self._there(np.concatenate([A, shift[:, ::-1, None]], axis=2))
        grid = F.affine_grid(theta, list(x.shape), align_corners=False)
        moved = F.grid_sample(x, grid, align_corners=False) * self._inside
        flipped = marks[..., ::-1] - shift[:, None, ::-1]
        found = np.einsum("bij,bpj->bpi", np.linalg.inv(A), flipped)[..., ::-1]
        return moved, found.astype(np.float32)

    def _away(self, n: int) -> tuple[Any, Any]:
        centre = self._drawn(-0.6, 0.6, n, 2, 1, 1)
        return self._down - centre[:, 0], self._right - centre[:, 1]

    def _paint(self, x: Any, cover: Any) -> Any:
        """A dull colour over the picture, as opaque as ``cover`` (B, side, side) says."""
        tone = self._drawn(20, 120, len(x)) * self._drawn(0.6, 1.0, len(x), 3, 1, 1)
        return x * (1 - cover[:, None]) + tone * cover[:, None] * self._inside

    def _bar(self, x: Any) -> Any:
        n = len(x)
        down, right = self._away(n)
        angle = self._drawn(0.0, math.pi, n, 1, 1)
        across = down * self._torch.cos(angle) - right * self._torch.sin(angle)
        along = down * self._torch.sin(angle) + right * self._torch.cos(angle)
        wide = self._drawn(*WIDTH, n, 1, 1)
        return self._paint(x, ((across.abs() < wide) & (along < 0)).float())

    def _dirt(self, x: Any) -> Any:
        n = len(x)
        away = self._torch.hypot(*self._away(n))
        radius = 2.0 * self._drawn(*SPOT, n, 1, 1)
        cover = self._torch.sigmoid((radius - away) / self._drawn(0.01, 0.06, n, 1, 1))
        return self._paint(x, cover * self._drawn(0.6, 1.0, n, 1, 1))

    def _smoke(self, x: Any) -> Any:
        n, F = len(x), self._torch.nn.functional
        coarse = self._drawn(0.0, 1.0, n, 1, 5, 5)
        veil = F.interpolate(coarse, (self._side, self._side), mode="bilinear", align_corners=True)
        veil = veil * self._drawn(*VEIL, n) * self._inside
        return x * (1 - veil) + self._drawn(170, 230, n) * veil

    def _dark(self, x: Any) -> Any:
        log = self._drawn(math.log(LIGHT[0]), math.log(LIGHT[1]), len(x))
        return x * self._torch.exp(log)

    def _blur(self, x: Any) -> Any:
        F = self._torch.nn.functional
        sigma = self._rng.uniform(*FOCUS)
        taps = np.exp(-0.5 * (np.arange(-4, 5) / sigma) ** 2)
        taps /= taps.sum()
        kernel = self._there(np.tile(np.outer(taps, taps), (3, 1, 1, 1)))
        return F.conv2d(x, kernel, padding=4, groups=3)


class Looked(Varied):
    """`Varied` for pictures that lie on the device, as (B, 3, side, side)."""

    def begin(self, seed: int, step: int) -> None:
        """What is drawn from now on depends on these alone."""
        self._rng = np.random.default_rng([seed, 1, step])

    def __call__(self, views: Any, marks: Any = None) -> Any:
        """Variants as float32 grey levels."""
        return self.dressed(self._moved(views.float(), np.zeros((len(views), 1, 2)))[0])


def inside_of(views: Array) -> Array:
    """Which pixels of pictures (N, side, side, 3) are ever lit, (side, side)."""
    return np.asarray(views[:: max(len(views) // 200, 1)].max(axis=(0, 3)) > 12)
