"""Forces at tip and trocar for ``observation.force``: the newest of every sensor. Values only.

In lock-step the forces of a tick may come before or after a policy's answer to it. An observation
therefore holds those of five ticks before, in every run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from surg_core.arm_view import ArmView
from surg_core.contract import FORCE_TICKS, TICK_NS
from surg_core.force.observed_force import NewestForces


class ServedForces:
    """The forces of the arms that a policy commands."""

    def __init__(self, arms: Sequence[str]) -> None:
        self._arms = {arm: NewestForces() for arm in arms}
        self._spoken: set[tuple[str, str]] = set()

    def take(self, arm: str, place: str, stamp_ns: int, f_B: NDArray[np.float64]) -> None:
        """A sample: ``place`` is tip or trocar, ``f_B`` (3,) in the arm's base frame [N]."""
        self._spoken.add((arm, place))
        self._arms[arm].take(place, stamp_ns, f_B)

    @property
    def silent(self) -> list[str]:
        """Arms of which no sensor has spoken yet."""
        return [
            arm for arm in self._arms if not {(arm, p) for p in ("tip", "trocar")} & self._spoken
        ]

    def behind(self, at_ns: int, expected: Mapping[str, Sequence[str]]) -> bool:
        """Lock-step: whether a sample that belongs to an observation has not arrived yet.

        Args:
            at_ns: Stamp of the observation, on the grid [ns].
            expected: Places that are measured, by arm.
        """
        due = at_ns - FORCE_TICKS * TICK_NS
        return any(
            self._arms[arm].stamp(place) < due
            for arm, places in expected.items()
            for place in places
        )

    def row(self, views: Mapping[str, ArmView], at_ns: int) -> NDArray[np.float32]:
        """The numbers of ``observation.force``, (8 n,); all arms' frames must be known."""
        numbers = []
        for arm, forces in self._arms.items():
            R_BR = views[arm].R_BR
            assert R_BR is not None  # every view of a cycle has it
            numbers += forces.row(at_ns, R_BR)
        return np.array(numbers, dtype="<f4")
