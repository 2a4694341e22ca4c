"""What belongs together: the newest values of all sources, matched by their stamps.

Only the newest value of a source is kept: an observation is never queued. In lock-step all sources
of a tick bear its stamp exactly; in free-run they may differ by a tolerance, and a source that is
further behind is named instead of served.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_policy_bridge.server.policy_arm import PERIOD, SECOND
from surg_policy_bridge.server.timers import CAMERA_PERIODS

STATE = "observation.state"
TASK_STATE = "privileged.task_state"
IMAGE = "observation.images."
"""Keys as in a dataset (docs/reference/datasets.md)."""
STILL = 1e-3
"""[m] What a tip may move without a drawn picture having to change."""
TOLERANCE = CAMERA_PERIODS * PERIOD
"""[ns] Free-run: largest difference between stamps of one observation."""


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """One observation.

    Attributes:
        step: Number of its grid time.
        stamp_ns: Stamp of the arms' state.
        arrays: By key, as the spec says.
        behind: How much older than the arms' state its oldest part is [ns].
    """

    step: int
    stamp_ns: int
    arrays: Mapping[str, NDArray[np.generic]]
    behind: int = 0


class CameraWatch:
    """Is a picture alive? One that stalls or repeats itself must not lead an arm (F08).

    Args:
        name: The camera's, for the texts.
        period: Between two pictures [ns].
    """

    def __init__(self, name: str, period: int = PERIOD) -> None:
        self._name, self._limit = name, CAMERA_PERIODS * period
        self._stamp, self._fingerprint = -1, -1
        self._arrived: int | None = None
        self._newer: int | None = None
        self._fresh: int | None = None
        self._place: Array | None = None

    def picture(self, now: int, stamp_ns: int, fingerprint: int) -> None:
        """A picture has come; ``fingerprint``: of its pixels."""
        self._arrived = now
        if stamp_ns > self._stamp:
            self._newer = now
            if fingerprint != self._fingerprint:
                self._fresh, self._place = now, None
        self._stamp, self._fingerprint = max(self._stamp, stamp_ns), fingerprint

    def problem(self, now: int, place: Array | None = None) -> str:
        """Empty, or why no policy may look at this camera.

        Args:
            now: Steady clock [ns].
            place: Where the tips are, (3 n,) [m], for a camera that is drawn and so has no noise: a
                scene at rest is the same picture again, and only one in which a tip has moved is
                expected to change. None: a real camera is never twice the same.
        """
        if self._fresh is None or self._newer is None or self._arrived is None:
            return f"no picture of {self._name} yet: is the camera running?"
        if self._place is None:
            self._place = place
        age = now - self._fresh
        if age <= self._limit or (now - self._newer <= self._limit and self._at_rest(place)):
            return ""
        silent = now - self._arrived > self._limit
        what = "sends nothing" if silent else "shows the same picture"
        return (
            f"the picture of {self._name} is {1e3 * age / SECOND:.0f} ms old (it {what}): check "
            "the camera and its cable, then enable the policy again"
        )

    def settle(self) -> None:
        """What was said of places until now does not count: the arms had no frame yet."""
        self._place = None

    def _at_rest(self, place: Array | None) -> bool:
        """Whether no tip has moved since the picture changed."""
        if place is None or self._place is None:
            return False
        return float(np.abs(place - self._place).max()) <= STILL


def apart(stamps: Mapping[str, int]) -> str:
    """Which arm's state is too old to be one observation with the others'; empty: none.

    Args:
        stamps: Of every arm's state [ns], by name.
    """
    last = min(stamps, key=lambda arm: stamps[arm])
    behind = max(stamps.values()) - stamps[last]
    if behind <= TOLERANCE:
        return ""
    return f"the state of {last} is {1e3 * behind / SECOND:.0f} ms behind the other arms'"


class Observer:
    """The newest value of every source, by the key that it is observed as.

    Args:
        keys: Of all sources; an observation is complete with all of them.
        tolerance: Largest difference of stamps [ns]; 0: they are equal (lock-step).
    """

    def __init__(self, keys: Sequence[str], tolerance: int) -> None:
        self._keys, self._tolerance = tuple(keys), tolerance
        self._newest: dict[str, tuple[int, NDArray[np.generic]]] = {}

    def put(self, key: str, stamp_ns: int, value: NDArray[np.generic]) -> None:
        """A value has come; one that was overtaken is dropped."""
        known = self._newest.get(key)
        if known is None or stamp_ns >= known[0] or known[0] - stamp_ns > self._tolerance:
            self._newest[key] = (stamp_ns, value)

    def missing(self, stamp_ns: int, keys: Iterable[str] | None = None) -> str:
        """What an observation of this stamp still waits for, in words; empty: nothing.

        Args:
            stamp_ns: Of the arms' state.
            keys: What is looked at; None: everything.
        """
        for key in self._keys if keys is None else keys:
            known = self._newest.get(key)
            if known is None:
                return f"{key} has not come yet"
            behind = stamp_ns - known[0]
            if abs(behind) > self._tolerance:
                where = "behind" if behind > 0 else "ahead of"
                return f"{key} is {1e3 * abs(behind) / SECOND:.0f} ms {where} the arms' state"
        return ""

    def take(
        self, step: int, stamp_ns: int, keys: Iterable[str] | None = None
    ) -> Observation | None:
        """The observation of this stamp, if all of it that is looked at is here."""
        wanted = self._keys if keys is None else tuple(keys)
        if self.missing(stamp_ns, wanted):
            return None
        arrays = {key: self._newest[key][1] for key in wanted}
        oldest = min((self._newest[key][0] for key in wanted), default=stamp_ns)
        return Observation(step, stamp_ns, arrays, max(stamp_ns - oldest, 0))
