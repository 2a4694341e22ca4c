"""What a PTP daemon says of this machine's clock: reading the answer of ``pmc``, and judging it.

Pure: text in, values out. ``clock_sync_node`` asks once a second, ``sync_report`` judges what was
recorded. linuxptp's offsets are *this clock minus the master's*, and so are ours.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping

QUESTIONS = ("TIME_STATUS_NP", "CURRENT_DATA_SET", "PARENT_DATA_SET", "PORT_DATA_SET")
"""Management ids that ``pmc`` is asked for, in this order."""

SOCKET = "/run/surg_ptp/ptp4l"
"""Where the daemon that ``./surg ptp`` starts can be asked."""

OFFSET_BOUND = 1e-3
"""Two clocks agree when they are no further apart than this [s]."""

MASTER, SLAVE, MEASURING = "MASTER", "SLAVE", "UNCALIBRATED"
"""Port states in which a clock can be in step: it leads, follows, or is measured without being
steered (a daemon with ``free_running``, or one that has not locked yet)."""

_ANSWER = re.compile(
    r"^\s*([0-9a-f]{6}\.[0-9a-f]{4}\.[0-9a-f]{6})-(\d+) seq \d+ (\w+) MANAGEMENT (\w+)"
)
_PAIR = re.compile(r"^\s+(\w+)\s+(\S+)\s*$")


@dataclasses.dataclass(frozen=True)
class ClockStatus:
    """One look at the clock."""

    port_state: str = ""
    """Of the PTP port, as linuxptp calls it; empty when the daemon did not answer."""
    offset: float = math.nan
    """This clock minus the grandmaster's [s]; 0 on the grandmaster, NaN while not measured."""
    path_delay: float = math.nan
    """One-way delay of the network [s]; NaN while not measured and on the grandmaster."""
    grandmaster: str = ""
    """Identity of the clock that all follow; empty: none is known."""
    clock: str = ""
    """Identity of this machine's clock."""
    problem: str = ""
    """Why nothing is known; empty when the daemon answered."""

    def fault(self, bound: float = OFFSET_BOUND) -> str:
        """Why this clock does not count as being in step; empty when it does.

        Args:
            bound: how far the clocks may be apart [s].
        """
        if self.problem:
            return self.problem
        if self.port_state == MASTER:
            return ""
        if self.port_state not in (SLAVE, MEASURING):
            return f"no PTP master is heard (port state {self.port_state or 'unknown'})"
        if not self.grandmaster or math.isnan(self.offset):
            return f"the offset is not measured yet (port state {self.port_state})"
        if not abs(self.offset) <= bound:
            return (
                f"the clock is {self.offset * 1e3:+.3f} ms off its master,"
                f" allowed are {bound * 1e3:g} ms"
            )
        return ""


def parse(text: str) -> ClockStatus:
    """Read what ``pmc`` printed when it was asked for ``QUESTIONS``.

    Answers may be missing, broken or in any order; what they do not say stays unknown. Of several
    ports the one that follows a master counts, else the first.

    Args:
        text: standard output of ``pmc``.
    """
    answers: dict[str, Mapping[str, str]] = {}
    ports: list[dict[str, str]] = []
    refused: list[str] = []
    clock = ""
    current: dict[str, str] | None = None
    for line in text.splitlines():
        head = _ANSWER.match(line)
        if head:
            current = {}
            identity, _, kind, name = head.groups()
            clock = clock or identity
            if kind != "RESPONSE" or name == "MANAGEMENT_ERROR_STATUS":
                refused.append(name)
            elif name == "PORT_DATA_SET":
                ports.append(current)
            else:
                answers[name] = current
            continue
        pair = _PAIR.match(line)
        if pair and current is not None:
            current[pair[1]] = pair[2]
    if not answers and not ports:
        said = " ".join(text.split())[:120]
        return ClockStatus(
            problem="the PTP daemon does not answer: is `./surg ptp` running on this machine?"
            + (f" (pmc said: {said})" if refused else "")
        )
    states = [port.get("portState", "") for port in ports]
    following = [state for state in states if state in (SLAVE, MEASURING)]
    state = following[0] if following else (states[0] if states else "")
    status = answers.get("TIME_STATUS_NP", {})
    present = status.get("gmPresent", "true") == "true"
    grandmaster = (
        status.get("gmIdentity") or answers.get("PARENT_DATA_SET", {}).get("grandmasterIdentity")
    ) or ""
    if state == MASTER:
        return ClockStatus(MASTER, 0.0, math.nan, grandmaster or clock, clock)
    current_set = answers.get("CURRENT_DATA_SET", {})
    delay = _seconds(current_set.get("meanPathDelay"))
    # Before the first exchange the daemon says 0 for everything.
    measured = present and state in (SLAVE, MEASURING) and status.get("ingress_time") != "0"
    measured = measured and delay != 0.0
    offset = _seconds(current_set.get("offsetFromMaster"))
    if math.isnan(offset):
        offset = _seconds(status.get("master_offset"))
    return ClockStatus(
        state,
        offset if measured else math.nan,
        delay if measured else math.nan,
        grandmaster if present and grandmaster != clock else "",
        clock,
    )


def _seconds(nanoseconds: str | None) -> float:
    """A number of nanoseconds as seconds; NaN for anything else."""
    try:
        value = float(nanoseconds or "nan") * 1e-9
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
