"""Parses and judges what a PTP daemon reports about this machine's clock through ``pmc``.

Text in, values out. ``clock_sync_node`` queries once a second, ``sync_report`` judges the recorded
values. linuxptp's offsets are *this clock minus the master's*, and so are ours.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping

QUESTIONS = ("TIME_STATUS_NP", "CURRENT_DATA_SET", "PARENT_DATA_SET", "PORT_DATA_SET")
"""Management ids that ``pmc`` is asked for, in this order."""

SOCKET = "/run/surg_ptp/ptp4l"
"""Socket of the daemon that ``./surg ptp`` starts."""

OFFSET_BOUND = 1e-3
"""Largest offset of two clocks that agree [s]."""

MASTER, SLAVE, MEASURING = "MASTER", "SLAVE", "UNCALIBRATED"
"""Port states in which a clock can be in step: it leads, follows, or is measured without being
steered (a daemon with ``free_running``, or one that has not locked yet)."""

_ANSWER = re.compile(
    r"^\s*([0-9a-f]{6}\.[0-9a-f]{4}\.[0-9a-f]{6})-(\d+) seq \d+ (\w+) MANAGEMENT (\w+)"
)
_PAIR = re.compile(r"^\s+(\w+)\s+(\S+)\s*$")


@dataclasses.dataclass(frozen=True)
class ClockStatus:
    """One sample of the clock's state."""

    port_state: str = ""
    """State of the PTP port, as linuxptp calls it; empty without an answer."""
    offset: float = math.nan
    """This clock minus the grandmaster's [s]; 0 on the grandmaster, NaN while not measured."""
    path_delay: float = math.nan
    """One-way delay of the network [s]; NaN while not measured and on the grandmaster."""
    grandmaster: str = ""
    """Identity of the clock that all follow; empty if unknown."""
    clock: str = ""
    problem: str = ""
    """Why the state is unknown; empty if the daemon answered."""

    def fault(self, bound: float = OFFSET_BOUND) -> str:
        """Why this clock is not synchronised within ``bound`` [s]; empty if it is."""
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
    """Parse the standard output of ``pmc`` for ``QUESTIONS``.

    Answers may be missing, broken or in any order; what they do not state stays unknown. Of several
    ports, the one that follows a master counts, otherwise the first.
    """
    answers = _Answers(text)
    if not answers.sets and not answers.ports:
        output = " ".join(text.split())[:120]
        return ClockStatus(
            problem="the PTP daemon does not answer: is `./surg ptp` running on this machine?"
            + (f" (pmc said: {output})" if answers.refused else "")
        )
    states = [port.get("portState", "") for port in answers.ports]
    following = [state for state in states if state in (SLAVE, MEASURING)]
    state = following[0] if following else (states[0] if states else "")
    status = answers.sets.get("TIME_STATUS_NP", {})
    current = answers.sets.get("CURRENT_DATA_SET", {})
    parent = answers.sets.get("PARENT_DATA_SET", {})
    grandmaster = status.get("gmIdentity") or parent.get("grandmasterIdentity") or ""
    if state == MASTER:
        return ClockStatus(MASTER, 0.0, math.nan, grandmaster or answers.clock, answers.clock)
    present = status.get("gmPresent", "true") == "true"
    delay = _seconds(current.get("meanPathDelay"))
    # Before the first exchange the daemon reports 0 for everything.
    measured = present and state in (SLAVE, MEASURING) and status.get("ingress_time") != "0"
    measured = measured and delay != 0.0
    offset = _seconds(current.get("offsetFromMaster"))
    if math.isnan(offset):
        offset = _seconds(status.get("master_offset"))
    return ClockStatus(
        state,
        offset if measured else math.nan,
        delay if measured else math.nan,
        grandmaster if present and grandmaster != answers.clock else "",
        answers.clock,
    )


class _Answers:
    """The responses in ``pmc``'s output: by data set, of every port, and the clock's identity."""

    def __init__(self, text: str) -> None:
        self.sets: dict[str, Mapping[str, str]] = {}
        self.ports: list[dict[str, str]] = []
        self.refused = False
        self.clock = ""
        current: dict[str, str] | None = None
        for line in text.splitlines():
            head = _ANSWER.match(line)
            pair = _PAIR.match(line)
            if head:
                current = {}
                identity, _, kind, name = head.groups()
                self.clock = self.clock or identity
                if kind != "RESPONSE" or name == "MANAGEMENT_ERROR_STATUS":
                    self.refused = True
                elif name == "PORT_DATA_SET":
                    self.ports.append(current)
                else:
                    self.sets[name] = current
            elif pair and current is not None:
                current[pair[1]] = pair[2]


def _seconds(nanoseconds: str | None) -> float:
    """A number of nanoseconds as seconds; NaN for anything else."""
    try:
        value = float(nanoseconds or "nan") * 1e-9
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
