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
UR3E = (
    (0.15185, 0.0, PI_2),
    (0.0, -0.24355, 0.0),
    (0.0, -0.2132, 0.0),
    (0.13105, 0.0, PI_2),
    (0.08535, 0.0, -PI_2),
    (0.0921, 0.0, 0.0),
)
UR10E = (
    (0.1807, 0.0, PI_2),
    (0.0, -0.6127, 0.0),
    (0.0, -0.57155, 0.0),
    (0.17415, 0.0, PI_2),
    (0.11985, 0.0, -PI_2),
    (0.11655, 0.0, 0.0),
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
XARM7 = (
    (0.0, 0.267, 0.0),
    (0.0, 0.0, -PI_2),
    (0.0, 0.293, PI_2),
    (0.0525, 0.0, PI_2),
    (0.0775, 0.3425, PI_2),
    (0.0, 0.0, PI_2),
    (0.076, 0.097, -PI_2),
)


def ur5e(q: Sequence[float]) -> Matrix:
    """Flange of a UR5e in ROS's base_link, (4, 4)."""
    return ur(q, UR5E)


def ur(q: Sequence[float], table: Sequence[tuple[float, float, float]]) -> Matrix:
    """Flange of a UR in ROS's base_link, (4, 4): UR's base turned by 180 degrees about z."""
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    for angle, (d, a, alpha) in zip(q, table, strict=True):
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
    """Flange of a Panda, or of an FR3, in its base frame, (4, 4)."""
    pose = modified(q, PANDA)
    pose[:3, 3] += PANDA_FLANGE * pose[:3, 2]
    return pose


def modified(q: Sequence[float], table: Sequence[tuple[float, float, float]]) -> Matrix:
    """Last frame of a chain of modified (Craig) DH parameters, (4, 4)."""
    pose = np.eye(4)
    for angle, (a, d, alpha) in zip(q, table, strict=True):
        ct, st, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return pose
