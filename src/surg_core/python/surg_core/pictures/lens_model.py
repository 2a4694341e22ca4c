"""Lens models of ROS: from a point before the camera to a pixel and back, with derivatives.

The models and their coefficients are those of ``sensor_msgs/CameraInfo``:

==================== ======================== =================================================
plumb_bob            k1 k2 p1 p2 k3           D. C. Brown, "Decentering distortion", 1966
rational_polynomial  the same, k4 k5 k6       OpenCV, ``calibrateCamera``
equidistant          k1 k2 k3 k4              J. Kannala and S. Brandt, 2006
==================== ======================== =================================================

A pixel's centre has integer coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from surg_core.lens_file import Lens
from surg_core.transforms import FloatArray

MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
"""The models in the order in which they are preferred."""


@dataclass(frozen=True)
class LensModel:
    """One eye.

    Attributes:
        model: One of ``MODELS``.
        size: Width and height of the picture [px].
        values: ``(4 + d,)`` fx, fy, cx, cy [px] and the d coefficients of the distortion.
    """

    model: str
    size: tuple[int, int]
    values: FloatArray

    @classmethod
    def of(cls, lens: Lens) -> LensModel:
        """From a lens file."""
        f_and_c = lens.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        size = (lens.width, lens.height)
        return cls(lens.distortion_model, size, np.concatenate([f_and_c, lens.D]))

    @property
    def K(self) -> FloatArray:
        """Camera matrix (3, 3)."""
        fx, fy, cx, cy = self.values[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def D(self) -> FloatArray:
        """Coefficients of the distortion (d,)."""
        return self.values[4:]

    def moved(self, step: FloatArray) -> LensModel:
        """The lens with values changed by ``step`` (4 + d,)."""
        return replace(self, values=self.values + step)

    def project(self, p_C: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) [m] before the camera."""
        xy = p_C[:, :2] / p_C[:, 2:]
        return self.values[2:4] + self.values[:2] * self._distort(xy)[0]

    def derivatives(self, p_C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels (n, 2), and their derivatives by the point (n, 2, 3) and by values (n, 2, 4 + d).

        Args:
            p_C: (n, 3) points before the camera [m].
        """
        n, f = len(p_C), self.values[:2]
        z = p_C[:, 2]
        xy = p_C[:, :2] / z[:, None]
        bent, by_xy, by_D = self._distort(xy)
        by_point = np.empty((n, 2, 3))
        by_point[:, :, :2] = by_xy / z[:, None, None]
        by_point[:, :, 2] = -np.einsum("nij,nj->ni", by_xy, xy) / z[:, None]
        by_point *= f[:, None]
        by_values = np.zeros((n, 2, len(self.values)))
        for axis in (0, 1):
            by_values[:, axis, axis] = bent[:, axis]
            by_values[:, axis, 2 + axis] = 1.0
        by_values[:, :, 4:] = f[:, None] * by_D
        return self.values[2:4] + f * bent, by_point, by_values

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Points (n, 3) of the plane z = 1 that the pixels (n, 2) see, by Newton steps.

        A pixel outside the model's range gives not a number.
        """
        bent = (np.asarray(pixels, dtype=np.float64) - self.values[2:4]) / self.values[:2]
        xy = bent.copy()
        for _ in range(20):
            found, by_xy, _ = self._distort(xy)
            singular = np.abs(np.linalg.det(by_xy)) < 1e-6
            by_xy[singular] = np.eye(2)
            step = np.linalg.solve(by_xy, (bent - found)[:, :, None])[:, :, 0]
            xy = xy + np.clip(step, -0.2, 0.2)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        good = np.abs(self._distort(xy)[0] - bent).max(axis=1, initial=0.0) < 1e-7
        return np.column_stack([np.where(good[:, None], xy, np.nan), np.ones(len(xy))])

    def _distort(self, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted points (n, 2) of the plane z = 1; derivatives by xy (n, 2, 2) and D (n, 2, d).

        Args:
            xy: (n, 2) points of the plane z = 1.
        """
        return _equidistant(xy, self.D) if self.model == "equidistant" else _brown(xy, self.D)


def _brown(xy: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Radial and tangential distortion, with or without a denominator."""
    x, y = xy.T
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([D, np.zeros(8 - len(D))])
    r2 = x * x + y * y
    powers = np.stack([r2, r2**2, r2**3], axis=-1)
    above = 1.0 + powers @ [k1, k2, k3]
    below = 1.0 + powers @ [k4, k5, k6]
    c = above / below
    slope = (k1 + 2 * k2 * r2 + 3 * k3 * r2**2 - c * (k4 + 2 * k5 * r2 + 3 * k6 * r2**2)) / below
    bent = np.column_stack(
        [
            x * c + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * c + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
    by_xy = np.empty((len(xy), 2, 2))
    by_xy[:, 0, 0] = c + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    by_xy[:, 1, 1] = c + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    by_xy[:, 0, 1] = by_xy[:, 1, 0] = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_D = np.empty((len(xy), 2, 8))
    outer = xy[:, :, None] * powers[:, None, :] / below[:, None, None]
    by_D[:, :, [0, 1, 4]] = outer
    by_D[:, :, 5:] = -outer * c[:, None, None]
    by_D[:, 0, 2] = by_D[:, 1, 3] = 2 * x * y
    by_D[:, 0, 3], by_D[:, 1, 2] = r2 + 2 * x * x, r2 + 2 * y * y
    return bent, by_xy, by_D[:, :, : len(D)]


def _equidistant(xy: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A fisheye: the angle off the axis sets the distance from the centre."""
    r = np.maximum(np.hypot(xy[:, 0], xy[:, 1]), 1e-9)
    angle = np.arctan(r)
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    bent_r = angle + powers @ D
    slope = (1.0 + angle[:, None] ** np.array([2, 4, 6, 8]) @ (D * [3, 5, 7, 9])) / (1.0 + r * r)
    share = bent_r / r
    u = xy / r[:, None]
    by_xy = share[:, None, None] * np.eye(2) + (
        (slope - share)[:, None, None] * u[:, :, None] * u[:, None, :]
    )
    return share[:, None] * xy, by_xy, u[:, :, None] * powers[:, None, :]
