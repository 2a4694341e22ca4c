"""Two eyes: points from pairs of pixels, and the rectified pictures that ROS expects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.pictures.lens_model import LensModel
from surg_core.transforms import FloatArray, inverse_pose, rotation_of, rotation_vector
from surg_perception.calibration.small_motions import moved, nearest_rotation, transform


@dataclass(frozen=True)
class Stereo:
    """Two lenses and the pose (4, 4) of the right eye in the left one."""

    left: LensModel
    right: LensModel
    X_LR: FloatArray

    def moved(self, step: FloatArray) -> Stereo:
        """After a step of the values of the left and the right lens and of X_LR."""
        n = len(self.left.values)
        return Stereo(
            self.left.moved(step[:n]),
            self.right.moved(step[n : 2 * n]),
            moved(self.X_LR, step[2 * n :]),
        )

    @property
    def eyes(self) -> tuple[tuple[LensModel, FloatArray], tuple[LensModel, FloatArray]]:
        """The lens of the left and of the right eye, and its pose (4, 4) in the left one."""
        return (self.left, np.eye(4)), (self.right, self.X_LR)

    @property
    def baseline(self) -> float:
        """Distance between the eyes [m]."""
        return float(np.linalg.norm(self.X_LR[:3, 3]))

    def project(self, p_L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3) in the left and in the right picture."""
        p_R = transform(inverse_pose(self.X_LR), p_L)
        return self.left.project(p_L), self.right.project(p_R)

    def triangulate(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Points (n, 3) in the left eye's frame that are nearest to both rays of pixels (n, 2)."""
        a, b = self.left.rays(left), self.right.rays(right) @ self.X_LR[:3, :3].T
        t = self.X_LR[:3, 3]
        # Depths u, v that minimise |u a - (t + v b)|.
        aa, bb, ab = (np.sum(p * q, axis=1) for p, q in ((a, a), (b, b), (a, b)))
        at, bt = a @ t, b @ t
        scale = aa * bb - ab * ab
        u, v = (bb * at - ab * bt) / scale, (ab * at - aa * bt) / scale
        return np.asarray(0.5 * (u[:, None] * a + t + v[:, None] * b))


@dataclass(frozen=True)
class Rectified:
    """Virtual pinholes with parallel axes, in which a point has the same row in both eyes.

    Attributes:
        stereo: The real eyes.
        R_left: (3, 3) from the left eye to its rectified one: rectification_matrix.
        R_right: (3, 3) the same of the right eye.
        f: Focal length of both [px].
        c: (2,) principal point of both [px].
    """

    stereo: Stereo
    R_left: FloatArray
    R_right: FloatArray
    f: float
    c: FloatArray

    @classmethod
    def of(cls, stereo: Stereo) -> Rectified:
        """Each eye turns by half the angle between them, then x follows the baseline."""
        R_LM = rotation_of(0.5 * rotation_vector(stereo.X_LR[:3, :3]))
        x = stereo.X_LR[:3, 3] / stereo.baseline
        y = np.cross(R_LM[:, 2], x)
        y /= np.linalg.norm(y)
        R_left = np.array([x, y, np.cross(x, y)])
        R_right = R_left @ stereo.X_LR[:3, :3]
        eyes = (stereo.left, R_left), (stereo.right, R_right)
        f = float(np.mean([lens.values[:2] for lens, _ in eyes]))
        centre = 0.5 * (np.array(stereo.left.size) - 1.0)
        seen = []
        for lens, R in eyes:
            ray = lens.rays(centre[None])[0] @ R.T
            seen.append(f * ray[:2] / ray[2])
        return cls(stereo, R_left, R_right, f, centre - np.mean(seen, axis=0))

    @property
    def P(self) -> tuple[FloatArray, FloatArray]:
        """Projection matrices (3, 4) of the left and the right eye, as in CameraInfo [px, px m]."""
        left = np.zeros((3, 4))
        left[0, 0] = left[1, 1] = self.f
        left[:2, 2], left[2, 2] = self.c, 1.0
        right = left.copy()
        right[0, 3] = -self.f * self.stereo.baseline
        return left, right

    def rows(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Row in the left minus row in the right rectified picture (n,) of pixels (n, 2) [px]."""
        y = []
        for lens, R, pixels in (
            (self.stereo.left, self.R_left, left),
            (self.stereo.right, self.R_right, right),
        ):
            ray = lens.rays(pixels) @ R.T
            y.append(self.f * ray[:, 1] / ray[:, 2])
        return np.asarray(y[0] - y[1])


def rigid_fit(p_B: FloatArray, p_A: FloatArray) -> FloatArray:
    """X_AB (4, 4) with p_A = X_AB p_B in the least-squares sense (Arun et al., 1987)."""
    a, b = p_A.mean(axis=0), p_B.mean(axis=0)
    R = nearest_rotation((p_A - a).T @ (p_B - b))
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, a - R @ b
    return X
