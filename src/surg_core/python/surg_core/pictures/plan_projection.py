"""Where planned tips are in an eye's raw picture: `p_V = X_WV^-1 X_WB X_BR p_R`, then the lens."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from surg_core import inverse_pose
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.transforms import FloatArray, quaternion_xyzw_to_matrix


def rcm_in_world(X_WB: FloatArray, q_BR: npt.ArrayLike, p_BRcm: npt.ArrayLike) -> FloatArray:
    """X_WR (4, 4): an arm's rcm frame in the world.

    Args:
        X_WB: (4, 4) the arm's base in the world [m].
        q_BR: (4,) rotation of the rcm frame in the base, x, y, z, w.
        p_BRcm: (3,) the trocar point in the base [m].
    """
    X_BR = np.eye(4)
    X_BR[:3, :3] = quaternion_xyzw_to_matrix(np.asarray(q_BR, dtype=np.float64))
    X_BR[:3, 3] = p_BRcm
    return np.asarray(X_WB @ X_BR)


def plan_pixels(
    p_R: FloatArray, X_WR: FloatArray, X_WV: FloatArray, eye: EyeProjection
) -> FloatArray:
    """Pixels (n, 2) of planned tips; NaN: the eye cannot see them.

    Args:
        p_R: (n, 3) tips in the arm's rcm frame [m].
        X_WR: (4, 4) that frame in the world [m].
        X_WV: (4, 4) the left eye in the world: x right, y down, z away [m].
        eye: Lens of the picture.
    """
    X_VR = inverse_pose(X_WV) @ X_WR
    return eye.pixels(p_R @ X_VR[:3, :3].T + X_VR[:3, 3])
