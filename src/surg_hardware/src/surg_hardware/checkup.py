"""What is good and what is wrong about an arm before it is driven; moves nothing, needs no ROS."""

from __future__ import annotations

import datetime
import math
import os
import resource
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import surg_core

Array = NDArray[np.float64]

LATE = 0.004
"""[s] A state that reaches a real arm's driver later than this, one in a hundred, is bad."""
DRIFT = 0.01
"""Largest share by which the robot's clock may run faster or slower than ours."""


@dataclass(frozen=True)
class Finding:
    """One line of a check-up; ``good`` is None for information, ``cure`` says what to do."""

    what: str
    text: str
    good: bool | None = True
    cure: str = ""

    def __str__(self) -> str:
        return f"{self.what}: {self.text}: {self.cure}"


@dataclass(frozen=True)
class Exchange:
    """How a robot's states arrive.

    Attributes:
        rate: States per second of our clock.
        drift: Rate of the robot's clock against ours, less 1.
        drift_error: Four times its standard error.
        late: (n,) delays of the states behind the fastest one [s].
    """

    rate: float
    drift: float
    drift_error: float
    late: Array

    @staticmethod
    def of(stamps: Sequence[float], arrivals: Sequence[float]) -> Exchange:
        """Of at least three states: the robot's times and their arrivals on our clock [s]."""
        theirs, ours = np.array(stamps) - stamps[0], np.array(arrivals) - arrivals[0]
        slope = float(np.polyfit(ours, theirs, 1)[0])
        offsets = ours - theirs / slope
        error = 4 * float(offsets.std() / (math.sqrt(len(ours)) * ours.std()))
        rate = (len(ours) - 1) / float(ours[-1])
        return Exchange(rate, slope - 1, error, offsets - offsets.min())


def exchange_findings(exchange: Exchange, emulated: bool) -> list[Finding]:
    """Rate and delay of the states, and the robot's clock."""
    late = _percentiles(exchange.late)[1] > LATE and not emulated
    steady = abs(exchange.drift) - exchange.drift_error <= DRIFT
    return [
        Finding(
            "states",
            f"{exchange.rate:.0f} per second, behind the fastest one by {_spread(exchange.late)}",
            None if emulated else not late,
            f"p99 must be below {1e3 * LATE:g} ms: use a cable of its own, end other programs, "
            "see the line of the real-time priority"
            if late
            else "",
        ),
        Finding(
            "clock",
            f"the robot's clock runs {100 * exchange.drift:+.3f} % against ours",
            steady,
            "" if steady else f"allowed is {100 * DRIFT:g} %: restart the robot's controller",
        ),
    ]


def round_trip_finding(trips: Sequence[float]) -> Finding:
    """The network's part: time from a question to its answer [s]."""
    return Finding("round trip", f"{_spread(np.array(trips))}, {len(trips)} questions", None)


def _spread(times: Array) -> str:
    """Percentiles of times [s] in words."""
    values = " / ".join(f"{1e3 * value:.2f}" for value in _percentiles(times))
    return f"{values} ms (p50 / p99 / max)"


def _percentiles(values: Array) -> tuple[float, float, float]:
    median, most_of_them = np.percentile(values, (50, 99))
    return float(median), float(most_of_them), float(values.max())


def real_time_finding(priority: int, emulated: bool) -> Finding:
    """Whether this user may have the driver's priority and lock its memory."""
    kernel = "real-time kernel" if "PREEMPT_RT" in os.uname().version else "ordinary kernel"
    highest, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    granted = highest == resource.RLIM_INFINITY or highest >= priority or os.geteuid() == 0
    text = f"priority {priority} is {'granted' if granted else 'not granted'}; {kernel}"
    if granted:
        return Finding("hardware.realtime", text)
    cure = (
        f"in /etc/security/limits.d/ give this user `rtprio {priority}` and `memlock unlimited`, "
        "then log in again (ulimit -r shows it)"
    )
    return Finding("hardware.realtime", text, None if emulated else False, cure)


def calibration_findings(arm: surg_core.Arm, today: datetime.date) -> list[Finding]:
    """Source and age of the calibrations. What a real arm must not use, loading has refused."""
    lines = []
    evidence: dict[str, surg_core.ToolCalibration | surg_core.TrocarCalibration] = {
        "tool": arm.tool,
        "trocar": arm.trocar,
    }
    for what, found in evidence.items():
        try:
            age = f"{(today - datetime.date.fromisoformat(found.date)).days} days old"
        except ValueError:
            age = f"of {found.date!r}"
        text = f"{found.source}, {age}, residual {1e3 * found.residual:.2f} mm"
        lines.append(Finding(f"calibration of the {what}", text, None))
    return lines
