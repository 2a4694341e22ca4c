"""A lens for the simulated endoscope: distortion and a dark edge, drawn into a pinhole's picture.

The phantom renders pinholes. A lens bends the picture: each pixel of the real picture looks along
another ray than the pinhole's pixel at the same place. So a larger pinhole picture is rendered, and
each pixel of the result is taken from where its ray meets it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surg_sim.arrays import Array, Picture


@dataclass(frozen=True)
class EndoscopeLens:
    """How a real eye differs from the pinhole that the instrument's file states.

    The distortion is the radial and tangential one of D. C. Brown, 1966, with the coefficients of
    CameraInfo's ``plumb_bob``.

    Attributes:
        distortion: k1, k2, p1, p2, k3.
        zoom: Focal length over the stated one.
        centre: Offset of the principal point from the middle, right and down [picture heights].
        edge: Share of the light that is lost in the corners of the picture.
    """

    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    zoom: float = 1.0
    centre: tuple[float, float] = (0.0, 0.0)
    edge: float = 0.0

    @property
    def perfect(self) -> bool:
        """Whether the lens is the pinhole itself."""
        return self == EndoscopeLens()

    def camera_matrix(self, f: float, width: int, height: int) -> Array:
        """True camera matrix (3, 3) for a stated focal length [px] and a size [px]."""
        cx, cy = (
            (width - 1) / 2 + self.centre[0] * height,
            (height - 1) / 2 + self.centre[1] * height,
        )
        return np.array([[self.zoom * f, 0.0, cx], [0.0, self.zoom * f, cy], [0.0, 0.0, 1.0]])

    def bend(self, xy: Array) -> Array:
        """Where rays (…, 2) of the plane z = 1 appear in the plane z = 1 of a pinhole."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        c = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * c + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * c + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )

    def rays(self, pixels: Array, f: float, width: int, height: int) -> Array:
        """Rays (…, 2) of the plane z = 1 that pixels (…, 2) see, by fixed-point steps."""
        K = self.camera_matrix(f, width, height)
        bent = (pixels - K[:2, 2]) / K[0, 0]
        xy = np.array(bent)
        for _ in range(40):
            step = bent - self.bend(xy)
            xy += step
            if np.abs(step).max() < 1e-9:
                break
        return xy

    def light(self, width: int, height: int) -> Array:
        """Share of the light (height, width) that reaches each pixel."""
        y, x = np.mgrid[:height, :width]
        r2 = (x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2
        return np.asarray(1.0 - self.edge * r2 / r2.max())


@dataclass(frozen=True)
class TrueEye:
    """One eye as it really is.

    Attributes:
        lens: The lens.
        f: Focal length that the instrument's file states [px].
        width: Of the picture [px].
        height: Of the picture [px].
    """

    lens: EndoscopeLens
    f: float
    width: int
    height: int

    @classmethod
    def of(cls, fovy: float, width: int, height: int, lens: EndoscopeLens) -> TrueEye:
        """From the vertical field of view [rad] that the instrument's file states."""
        return cls(lens, height / 2 / float(np.tan(fovy / 2)), width, height)

    @property
    def K(self) -> Array:
        """True camera matrix (3, 3)."""
        return self.lens.camera_matrix(self.f, self.width, self.height)

    def project(self, p_C: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) before the eye."""
        bent = self.lens.bend(p_C[:, :2] / p_C[:, 2:])
        return np.asarray(bent * self.K[0, 0] + self.K[:2, 2])

    def rays(self) -> Array:
        """Rays (height, width, 2) of the plane z = 1 that its pixels see."""
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        return self.lens.rays(np.stack([x, y], axis=-1), self.f, self.width, self.height)

    def light(self) -> Array:
        """Share of the light (height, width) that reaches each pixel."""
        return self.lens.light(self.width, self.height)


@dataclass(frozen=True)
class LensRemap:
    """Makes the picture of an eye with a lens from a wider picture of a pinhole."""

    eye: TrueEye

    @cached_property
    def wide_size(self) -> tuple[int, int]:
        """Width and height of the pinhole's picture that holds all rays of the lens [px]."""
        half = np.abs(self.eye.rays()).reshape(-1, 2).max(axis=0) * self.eye.f + 1.0
        stated = np.array([self.eye.width, self.eye.height])
        wide, high = np.maximum(stated, 2 * np.ceil(half).astype(int))
        return int(wide), int(high)

    @cached_property
    def _map(self) -> Array:
        return np.asarray(self.eye.rays() * self.eye.f, dtype=np.float32)

    @cached_property
    def _light(self) -> Array:
        return np.asarray(self.eye.light()[:, :, None], dtype=np.float32)

    def apply(self, wide: Picture) -> Picture:
        """The lens's picture from a pinhole's of the same focal length [px], rgb8."""
        import cv2  # only a lens needs it: the rest of the package runs without OpenCV

        height, width = wide.shape[:2]
        middle = np.array([(width - 1) / 2, (height - 1) / 2], dtype=np.float32)
        bent = cv2.remap(wide, self._map + middle, None, cv2.INTER_LINEAR)
        if self.eye.lens.edge:
            bent = np.asarray(bent * self._light + 0.5, dtype=np.uint8)
        return np.asarray(bent)
