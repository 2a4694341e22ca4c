"""A piece of an instrument's shaft, before an eye."""

from __future__ import annotations

from dataclasses import dataclass

from surg_core.transforms import FloatArray


@dataclass(frozen=True)
class ShaftAxis:
    """A piece of shaft as joints put it.

    Attributes:
        arm: Whose.
        p_TipP_F: (n, 3) points from the tip, in the flange's axes [m].
        p_W: (n, 3) in the world.
        p_V: (n, 3) before the left eye.
        R_WF: (3, 3).
        R_VW: (3, 3).
        v_V: (n, 3) speed before the left eye [m/s].
    """

    arm: str
    p_TipP_F: FloatArray
    p_W: FloatArray
    p_V: FloatArray
    R_WF: FloatArray
    R_VW: FloatArray
    v_V: FloatArray
