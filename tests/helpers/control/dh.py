"""Forward kinematics by Denavit-Hartenberg parameters as the makers publish them: an oracle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

PI_2 = math.pi / 2.0
# d [m], a [m], alpha [rad] per joint; standard DH, in UR's own base frame.
UR5E = (
    (0.1625, 0.0, PI_2),
    (0.0, -0.425, 0.0),
    (0.0, -0.3922, 0.0),
    (0.1333, 0.0, PI_2),
    (0.0997, 0.0, -PI_2),
    (0.0996, 0.0, 0.0),
)
# a [m], d [m], alpha [rad] per joint; modified (Craig) DH.
PANDA = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -PI_2),
    (0.0, 0.316, PI_2),
    (0.0825, 0.0, PI_2),
    (-0.0825, 0.384, -PI_2),
    (0.0, 0.0, PI_2),
    (0.088, 0.0, PI_2),
)
PANDA_FLANGE = 0.107


def ur5e(q: Sequence[float]) -> Matrix:
    """Flange of a UR5e in ROS's base_link, (4, 4): UR's base turned by 180 degrees about z."""
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    for angle, (d, a, alpha) in zip(q, UR5E, strict=True):
        ct, st, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0.0, sa, ca, d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return pose


def panda(q: Sequence[float]) -> Matrix:
    """Flange of a Panda in its base frame, (4, 4)."""
    pose = np.eye(4)
    for angle, (a, d, alpha) in zip(q, PANDA, strict=True):
        ct, st, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    pose[:3, 3] += PANDA_FLANGE * pose[:3, 2]
    return pose
