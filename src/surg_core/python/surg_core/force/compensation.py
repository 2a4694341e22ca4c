"""Takes bias and weight of the tool off the reading of a six-axis sensor at the flange.

Wrenches are (force, moment), (6,), in N and N m. A reading is what the tool exerts on the sensor,
about the sensor's origin, in the sensor's axes S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray, skew

GRAVITY = 9.80665
"""[m/s^2] Standard gravity; it differs by at most 0.3 % between places."""
PARAMETERS = 13
"""Of a load: mass, centre (3), bias force (3), bias moment (3), turn of the frame (3)."""


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a x b of two (3,); ten times as fast as ``np.cross``."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@dataclass(frozen=True, eq=False)
class ToolLoad:
    """What a free tool does to the sensor, as measured.

    Attributes:
        mass: Of everything that hangs on the sensor [kg].
        p_SCom: (3,) its centre of mass from the sensor's origin, in S [m].
        bias: (6,) reading without any load [N, N m].
        R_FS: (3, 3) the sensor's axes in the flange.
        p_FS: (3,) the sensor's origin in the flange [m]; from its drawing.
        covariance: (13, 13) of mass, p_SCom, bias and a turn phi with R_true = R_FS exp([phi]).
    """

    mass: float
    p_SCom: FloatArray
    bias: FloatArray
    R_FS: FloatArray
    p_FS: FloatArray
    covariance: FloatArray

    def weight(self, g_S: FloatArray) -> FloatArray:
        """(6,) reading of the free tool at rest without bias; g_S (3,) gravity in S [m/s^2]."""
        force = self.mass * g_S
        return np.concatenate([force, cross(self.p_SCom, force)])


def external_wrench(
    load: ToolLoad, reading: FloatArray, R_BF: FloatArray, g_B: FloatArray
) -> FloatArray:
    """What the surroundings exert on a tool that does not accelerate.

    Args:
        load: As measured.
        reading: (6,) of the sensor, in S.
        R_BF: (3, 3) flange in the base.
        g_B: (3,) gravity in the base [m/s^2].

    Returns:
        (6,) force and moment about the sensor's origin, in the base's axes.
    """
    R_BS = R_BF @ load.R_FS
    net = reading - load.bias
    weight = load.mass * g_B
    moment = R_BS @ net[3:] - cross(R_BS @ load.p_SCom, weight)
    return np.concatenate([R_BS @ net[:3] - weight, moment])


def external_jacobian(
    load: ToolLoad, reading: FloatArray, R_BF: FloatArray, g_B: FloatArray
) -> FloatArray:
    """(6, 13) derivative of :func:`external_wrench` by the load's parameters, in their order."""
    R_BS = R_BF @ load.R_FS
    net = reading - load.bias
    weight = load.mass * g_B
    J = np.zeros((6, PARAMETERS))
    J[:3, 0] = -g_B
    J[3:, 0] = -cross(R_BS @ load.p_SCom, g_B)
    J[3:, 1:4] = skew(weight) @ R_BS
    J[:3, 4:7] = J[3:, 7:10] = -R_BS
    J[:3, 10:] = -R_BS @ skew(net[:3])
    J[3:, 10:] = -R_BS @ skew(net[3:]) - skew(weight) @ R_BS @ skew(load.p_SCom)
    return J


def moved(wrench: FloatArray, lever: FloatArray) -> FloatArray:
    """The same (6,) wrench about another point; lever (3,) from the new point to the old one."""
    return np.concatenate([wrench[:3], wrench[3:] + cross(lever, wrench[:3])])


def gravity_in_base(R_WB: FloatArray) -> FloatArray:
    """(3,) gravity in the axes of a base that stands in the world with R_WB (3, 3) [m/s^2]."""
    return np.array(np.asarray(R_WB)[2] * -GRAVITY)
