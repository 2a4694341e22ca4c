"""Assembles observations: the newest values of all sources, matched by their stamps.

Only the newest value of a source is kept; observations are never queued. In lock-step all sources
of a tick have exactly its stamp. In free-run stamps may differ by a tolerance; a source further
behind is reported instead of served.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server.timers import CAMERA_PERIODS

STILL = 1e-3
"""[m] Motion of a tip that need not change a rendered picture."""
TOLERANCE = CAMERA_PERIODS * STEP_NS
"""[ns] Free-run: largest difference between stamps of one observation."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """One observation."""

    step: int  # number of its grid time
    stamp_ns: int  # stamp of the arms' state
    arrays: Mapping[str, NDArray[np.generic]]  # by key, as the spec says
    behind: int = 0  # age of its oldest part relative to the arms' state [ns]


class CameraWatch:
    """Detects a stalled or frozen camera, which must not guide an arm (F08); ``period`` in [ns]."""

    def __init__(self, name: str, period: int = STEP_NS) -> None:
        self._name, self._limit = name, CAMERA_PERIODS * period
        self._stamp, self._checksum = -1, -1
        self._arrived: int | None = None
        self._newer: int | None = None
        self._fresh: int | None = None
        self._tips: Array | None = None
        self._moved: int | None = None

    def picture(self, now: int, stamp_ns: int, checksum: int) -> None:
        """A picture has arrived; ``checksum``: of its pixels."""
        self._arrived = now
        if stamp_ns > self._stamp:
            self._newer = now
            if checksum != self._checksum:
                self._fresh, self._tips, self._moved = now, None, None
        self._stamp, self._checksum = max(self._stamp, stamp_ns), checksum

    def problem(self, now: int, tips: Array | None = None) -> str:
        """Why no policy may use this camera; empty: it may.

        Args:
            now: Steady clock [ns].
            tips: Positions of all tips, (3 n,) [m], for a rendered camera. It has no noise, so its
                picture is expected to change only after a tip has moved. None: a real camera, whose
                pictures always differ.
        """
        if self._fresh is None or self._newer is None or self._arrived is None:
            return f"no picture of {self._name} yet; check that the camera is running"
        age = now - self._newer
        if age <= self._limit:  # they come; do they change, when they should?
            age = now - self._should_have_changed(now, tips)
        if age <= self._limit:
            return ""
        silent = now - self._arrived > self._limit
        symptom = "sends no pictures" if silent else "repeats the same picture"
        return (
            f"the picture is {1e3 * age / SECOND_NS:.0f} ms old ({self._name} {symptom}); check "
            "the camera and its cable, then enable the policy again"
        )

    def forget_tips(self) -> None:
        """Earlier tip positions are invalid: the arms had no rcm frame yet."""
        self._tips = self._moved = None

    def _should_have_changed(self, now: int, tips: Array | None) -> int:
        """Since when [ns] the picture shows something else than what is there; now: it does not."""
        assert self._fresh is not None
        if tips is None:
            return self._fresh
        if self._tips is None:
            self._tips = tips
        if self._moved is None and float(np.abs(tips - self._tips).max()) > STILL:
            self._moved = now
        return now if self._moved is None else self._moved


def lagging_arm(stamps: Mapping[str, int]) -> str:
    """Which arm's state [ns] is too old for an observation with the others; empty: none."""
    last = min(stamps, key=lambda arm: stamps[arm])
    behind = max(stamps.values()) - stamps[last]
    if behind <= TOLERANCE:
        return ""
    return f"the state of {last} is {1e3 * behind / SECOND_NS:.0f} ms behind the other arms'"


class Observer:
    """The newest value of every source, by its key in the observation.

    ``tolerance`` is the largest difference of stamps [ns]; 0 in lock-step.
    """

    def __init__(self, keys: Sequence[str], tolerance: int) -> None:
        self._keys, self._tolerance = tuple(keys), tolerance
        self._newest: dict[str, tuple[int, NDArray[np.generic]]] = {}

    def put(self, key: str, stamp_ns: int, value: NDArray[np.generic]) -> None:
        """A value has arrived; one older than the present value is dropped."""
        known = self._newest.get(key)
        if known is None or stamp_ns >= known[0] or known[0] - stamp_ns > self._tolerance:
            self._newest[key] = (stamp_ns, value)

    def missing(self, stamp_ns: int, keys: Iterable[str] | None = None) -> str:
        """What is missing for an observation of this stamp [ns] with these keys (None: all)."""
        for key in self._keys if keys is None else keys:
            known = self._newest.get(key)
            if known is None:
                return f"{key} has not arrived yet"
            behind = stamp_ns - known[0]
            if abs(behind) > self._tolerance:
                where = "behind" if behind > 0 else "ahead of"
                return f"{key} is {1e3 * abs(behind) / SECOND_NS:.0f} ms {where} the arms' state"
        return ""

    def take(
        self, step: int, stamp_ns: int, keys: Iterable[str] | None = None
    ) -> Observation | None:
        """The observation of this stamp, if it is complete."""
        wanted = self._keys if keys is None else tuple(keys)
        if self.missing(stamp_ns, wanted):
            return None
        arrays = {key: self._newest[key][1] for key in wanted}
        oldest = min((self._newest[key][0] for key in wanted), default=stamp_ns)
        return Observation(step, stamp_ns, arrays, max(stamp_ns - oldest, 0))
