"""The force at an instrument's tip as the hand that drives it shall feel it: in the view's axes.

Values only. The scale, the limits and the passivity are those of the device that plays the force.
"""

from __future__ import annotations

import numpy as np

from surg_core.transforms import FloatArray


class ForceFeedback:
    """The newest force of one arm, and whether the hand may feel it."""

    def __init__(self) -> None:
        self._R_VB: FloatArray | None = None

    def follow(self, following: bool, R_WB: FloatArray, R_WV: FloatArray | None) -> bool:
        """One tick: does the arm follow the hand, and how are base and view turned in the world?

        Returns whether it has just ended, so that the hand must be told at once.
        """
        felt = self._R_VB is not None
        known = following and R_WV is not None and bool(np.isfinite(R_WV).all())
        self._R_VB = R_WV.T @ R_WB if known and R_WV is not None else None
        return felt and self._R_VB is None

    def take(self, stamp_ns: int, f_B: FloatArray) -> FloatArray | None:
        """A force on the tip, (3,) in the arm's base frame [N]; stamp 0: it is not known.

        Returns the force in the view frame [N], (3,); None: nothing may be felt.
        """
        if stamp_ns == 0 or self._R_VB is None or not np.isfinite(f_B).all():
            return None
        return np.asarray(self._R_VB @ f_B)
