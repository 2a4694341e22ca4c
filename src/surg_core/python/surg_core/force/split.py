"""Divides the wrench on a shaft between its two contacts: the tip and the trocar.

With the moment taken about the trocar's point on the shaft, only the tip's force has a lever, the
depth L along the unit axis s. Hence the lateral forces in closed form,

    f_tip = (tau x s) / L,      f_trocar = F - s (s . F) - f_tip,

four equations for four unknowns. The axial sum s . F belongs to both contacts, and no measurement
at the flange divides it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.force.compensation import cross
from surg_core.transforms import FloatArray, skew


@dataclass(frozen=True, eq=False)
class ShaftForces:
    """Forces of the surroundings on the instrument, in the axes of the wrench.

    Attributes:
        tip: (3,) lateral force on the tip [N].
        trocar: (3,) lateral force on the shaft at the trocar [N].
        axial: Sum of both axial forces along s [N].
        twist: Moment about the shaft [N m]; 0 without a contact beside the axis.
        s: (3,) unit axis, towards the tip.
        depth: L, from the trocar's point on the shaft to the tip [m].
    """

    tip: FloatArray
    trocar: FloatArray
    axial: float
    twist: float
    s: FloatArray
    depth: float


def split(wrench: FloatArray, s: FloatArray, depth: float) -> ShaftForces:
    """Split (6,) a wrench about the trocar's point on the shaft.

    Args:
        wrench: Force [N] and moment [N m] of the surroundings on the instrument.
        s: (3,) unit shaft axis.
        depth: Of the tip behind that point [m].

    Raises:
        ValueError: The depth is not positive: both contacts are one.
    """
    if not depth > 0.0:
        raise ValueError(f"depth {depth:g} m; a positive one is needed to split a force")
    force, moment = wrench[:3], wrench[3:]
    axial = float(s @ force)
    tip = cross(moment, s) / depth
    return ShaftForces(tip, force - axial * s - tip, axial, float(s @ moment), s, depth)


def split_matrix(s: FloatArray, depth: float) -> FloatArray:
    """(7, 6) M with (tip, trocar, axial) = M wrench, as in :func:`split`."""
    M = np.zeros((7, 6))
    M[:3, 3:] = -skew(s) / depth
    M[3:6, :3] = np.eye(3) - np.outer(s, s)
    M[3:6, 3:] = skew(s) / depth
    M[6, :3] = s
    return M


def pivot_jacobian(forces: ShaftForces) -> FloatArray:
    """(7, 3) derivative of (tip, trocar, axial) by where the trocar is, in the wrench's axes [m].

    The wrench keeps the point that it refers to. A trocar that is d deeper shortens the lever; one
    beside the shaft gives the axial sum a lever.
    """
    s, depth = forces.s, forces.depth
    F = forces.tip + forces.trocar + forces.axial * s
    by_pivot = np.zeros((7, 3))
    by_pivot[:3] = (np.outer(forces.tip, s) - skew(s) @ skew(F)) / depth
    by_pivot[3:6] = -by_pivot[:3]
    return by_pivot
