"""From points before the left eye to pixels of one eye's raw picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surg_core import inverse_pose
from surg_core.lens_file import Lens
from surg_core.pictures.lens_model import LensModel
from surg_core.transforms import FloatArray

NEAREST = 0.005
"""[m] What is nearer to the eye is not drawn."""
BEYOND = 1.1
"""How far beyond the picture's corners a lens's formula is believed, relative."""


class EyeProjection:
    """From points before the left eye to pixels of one eye's raw picture.

    Args:
        lens: Of this eye, for the picture's size.
        X_VE: (4, 4) this eye in the left one [m].
    """

    def __init__(self, lens: Lens, X_VE: FloatArray) -> None:
        self.size = (lens.width, lens.height)
        self._model, self._X_EV = LensModel.of(lens), inverse_pose(X_VE)
        x, y = np.linspace(0, lens.width - 1, 9), np.linspace(0, lens.height - 1, 9)
        edge = [(a, b) for a in x for b in (y[0], y[-1])]
        edge += [(a, b) for b in y for a in (x[0], x[-1])]
        rays = self._model.rays(np.array(edge))[:, :2]
        self._widest = BEYOND * float(np.nanmax(np.linalg.norm(rays, axis=1)))

    def pixels(self, p_V: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) before the left eye [m]; NaN: the eye cannot see them."""
        seen, found = self.sees(p_V), np.full((len(p_V), 2), np.nan)
        found[seen] = self._model.project(self.before(p_V[seen]))
        return found

    def sees(self, p_V: FloatArray) -> NDArray[np.bool_]:
        """(...) whether points (..., 3) before the left eye are where the lens's formula holds."""
        p = self.before(p_V)
        wide = np.hypot(p[..., 0], p[..., 1]) < self._widest * p[..., 2]
        return np.asarray(wide & (p[..., 2] > NEAREST))

    def derivative(self, p_V: FloatArray) -> FloatArray:
        """(..., 2, 3) of pixels by points (..., 3) before the left eye [px/m]."""
        return np.asarray(self._by_point(self.before(p_V)) @ self._X_EV[:3, :3])

    def slopes(self, p_V: FloatArray) -> tuple[FloatArray, FloatArray]:
        """That, and (..., 2, 2) derivatives of the plane z = 1 by pixels there [1/px]."""
        p = self.before(p_V)
        by_point = self._by_point(p)
        per_pixel = np.linalg.inv(by_point[..., :2] * p[..., 2, None, None])
        return by_point @ self._X_EV[:3, :3], per_pixel

    def _by_point(self, p: FloatArray) -> FloatArray:
        """(..., 2, 3) of pixels by points (..., 3) before this eye [px/m]."""
        return self._model.derivatives(p.reshape(-1, 3))[1].reshape(*p.shape[:-1], 2, 3)

    def before(self, p_V: FloatArray) -> FloatArray:
        """Points (..., 3) before the left eye, before this one [m]."""
        return np.asarray(p_V @ self._X_EV[:3, :3].T + self._X_EV[:3, 3])

    def plane(self, p_V: FloatArray) -> FloatArray:
        """Where points (..., 3) before the left eye [m] lie in this eye's plane z = 1, (..., 2)."""
        p = self.before(p_V)
        return np.asarray(p[..., :2] / p[..., 2:])

    def plane_of(self, pixels: FloatArray) -> FloatArray:
        """What pixels (n, 2) see in this eye's plane z = 1, (n, 2); NaN: beyond the lens."""
        found = self._model.rays(pixels)[:, :2]
        found[~(np.hypot(*found.T) < self._widest)] = np.nan
        return found
