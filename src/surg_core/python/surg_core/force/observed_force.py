"""The forces of an arm as a policy and a data set see them: ``observation.force``.

A force that is not known is zero with ``known`` 0, so that a network gets no NaN and still learns
the difference. Values in, values out.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from surg_core.contract import FORCE_TIMEOUT_NS
from surg_core.transforms import FloatArray

PLACES = ("tip", "trocar")
"""Where forces are known, in the order of ``contract.ARM_FORCE``."""
TOPICS = {"tip": "tool/measured_cf", "trocar": "trocar/measured_cf"}
"""Below the arm, by place."""


def arm_force(
    f_tip_B: FloatArray | None, f_trocar_B: FloatArray | None, R_BR: FloatArray
) -> list[float]:
    """The numbers of ``contract.ARM_FORCE``.

    Args:
        f_tip_B: (3,) force on the tip in the arm's base frame [N]; None: not known.
        f_trocar_B: (3,) force of the shaft on the trocar [N]; None: not known.
        R_BR: (3, 3) orientation of the rcm frame in the base.
    """
    row: list[float] = []
    for f_B in (f_tip_B, f_trocar_B):
        if f_B is None or not np.isfinite(f_B).all():
            row += [0.0] * 4
        else:
            row += [*(float(v) for v in R_BR.T @ f_B), 1.0]
    return row


class NewestForces:
    """What the sensors of one arm said last."""

    def __init__(self) -> None:
        self._last: dict[str, deque[tuple[int, FloatArray]]] = {p: deque(maxlen=2) for p in PLACES}

    def take(self, place: str, stamp_ns: int, f_B: FloatArray) -> None:
        """A sample of a place; with stamp 0 the sensor says that it does not know."""
        if stamp_ns > 0 and np.isfinite(f_B).all():
            self._last[place].append((stamp_ns, np.array(f_B, dtype=np.float64)))
        else:
            self._last[place].clear()

    def stamp(self, place: str) -> float:
        """Of the newest sample [ns]; minus infinity: there is none."""
        return self._last[place][-1][0] if self._last[place] else -math.inf

    def row(self, at_ns: int, R_BR: FloatArray) -> list[float]:
        """``arm_force`` as measured before a time [ns], and not `FORCE_TIMEOUT_NS` before it.

        In lock-step the force of a tick may come before or after the answer to it: it counts from
        the next one on.
        """
        tip, trocar = (self._before(place, at_ns) for place in PLACES)
        return arm_force(tip, trocar, R_BR)

    def _before(self, place: str, at_ns: int) -> FloatArray | None:
        known = [f for stamp, f in self._last[place] if 0 < at_ns - stamp <= FORCE_TIMEOUT_NS]
        return known[-1] if known else None
