"""The rehearsal of an arm's stops: what to do, what must happen, and the report. No ROS.

Each stop of the table in docs/guide/link_ur.md once, while the tip moves at 10 mm/s.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

REST_S = 0.12
"""[s] From the event to rest at most."""
PIVOT_M = 0.0002
"""[m] Deviation of the shaft from its pivot at most."""
SEEN_S = 0.05
"""[s] A longer pause between two states hides the way to rest."""
RESTING = 1e-3
"""[rad/s] Of the fastest joint: the arm is at rest."""


@dataclass(frozen=True)
class RehearsalStep:
    """One stop.

    Attributes:
        name: Its name in the report.
        do: What the person does; empty: this program kills `victim`.
        victim: `driver`, `controller` or `node`; empty: the person acts.
        conditions: What the link may say then.
        reason: Why the controller is in FAULT then; empty: it is the controller that is gone.
        after: How to go on.
    """

    name: str
    do: str
    victim: str
    conditions: tuple[str, ...]
    reason: str
    after: str


STEPS = (
    RehearsalStep(
        "emergency stop", "press the emergency stop", "", ("ESTOP",), "robot",
        "release the button, then ./surg robot CELL on",
    ),
    RehearsalStep(
        "protective stop", "push the arm with your hand until it stops", "", ("STOPPED",), "robot",
        "./surg robot CELL recover",
    ),
    RehearsalStep(
        "speed slider", "set the speed slider to 50 %", "", ("SLOWED", "READY"), "robot",
        "set the speed slider to 100 %",
    ),
    RehearsalStep(
        "unplugged cable", "pull the robot's cable out", "", ("OFFLINE",), "link",
        "plug the cable in and wait 5 s",
    ),
    RehearsalStep(
        "driver killed", "", "driver", ("OFFLINE", "READY"), "link",
        "nothing: the node has started the driver again",
    ),
    RehearsalStep(
        "controller killed", "", "controller", ("READY",), "",
        "end ./surg up with Ctrl-C and start it again",
    ),
    RehearsalStep(
        "node killed", "", "node", (), "link", "end ./surg up with Ctrl-C and start it again"
    ),
)  # fmt: skip


@dataclass(frozen=True)
class RehearsalOutcome:
    """What was measured at one stop; NaN: no states came while the arm came to rest.

    Attributes:
        step: Name of the stop.
        date: Of the rehearsal.
        serial: Of the arm.
        to_rest: From the event to rest [s].
        deviation: Largest deviation from the pivot after the event [m].
        condition: What the link said at the end.
        reason: Why the controller was in FAULT.
        problems: What was not as it must be; empty: passed.
    """

    step: str
    date: str
    serial: str
    to_rest: float
    deviation: float
    condition: str
    reason: str
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Trace:
    """What the link and the controller said round an event: times are of one clock [s].

    Attributes:
        times: (n,) of the joint states.
        speeds: (n,) of the fastest joint [rad/s].
        deviations: (n,) of the shaft from the pivot [m].
        condition: Of the link, at the end; empty: it says nothing.
        reason: Of the controller's FAULT, at the end; empty: none.
    """

    times: Sequence[float]
    speeds: Sequence[float]
    deviations: Sequence[float]
    condition: str
    reason: str


def judge(
    step: RehearsalStep, event: float, trace: Trace, date: str, serial: str
) -> RehearsalOutcome:
    """Compare a stop with what must happen.

    Args:
        step: The stop.
        event: When it happened, on the trace's clock [s].
        trace: From before the event until seconds after it.
        date: For the report.
        serial: For the report.
    """
    after = [n for n, time in enumerate(trace.times) if time >= event]
    moving = [n for n in after if trace.speeds[n] > RESTING]
    rests = bool(after) and (not moving or moving[-1] < after[-1])
    still = next((n for n in after if trace.speeds[n] <= RESTING), None)
    seen = still is not None and _longest_pause(trace.times, event, still) <= SEEN_S
    to_rest = trace.times[still] - event if still is not None and seen else math.nan
    deviation = max((trace.deviations[n] for n in after), default=math.nan)
    problems = []
    if not any(speed > RESTING for n, speed in enumerate(trace.speeds) if trace.times[n] < event):
        problems.append("the arm stood still when it happened: repeat this stop")
    if not math.isnan(to_rest) and to_rest > REST_S:
        problems.append(f"at rest after {1e3 * to_rest:.0f} ms; allowed {1e3 * REST_S:.0f} ms")
    if deviation > PIVOT_M:
        problems.append(f"{1e3 * deviation:.2f} mm off the pivot; allowed {1e3 * PIVOT_M:.1f} mm")
    if still is not None and moving and moving[-1] > still + 25:
        problems.append("the arm moved again after it had come to rest")
    if not rests and still is None and "OFFLINE" not in step.conditions and step.victim != "node":
        problems.append("the arm did not come to rest")
    if step.conditions and trace.condition not in step.conditions:
        problems.append(f"the link says {trace.condition}; expected {' or '.join(step.conditions)}")
    if step.reason and trace.reason != step.reason:
        problems.append(f"the controller's FAULT is {trace.reason!r}; expected {step.reason!r}")
    return RehearsalOutcome(
        step.name, date, serial, to_rest, deviation, trace.condition, trace.reason, tuple(problems)
    )


def _longest_pause(times: Sequence[float], event: float, until: int) -> float:
    """Longest time without a state from the event to the state `until` [s]."""
    seen = [event, *(time for time in times[: until + 1] if time > event)]
    return max((b - a for a, b in itertools.pairwise(seen)), default=0.0)


def load(file: Path) -> dict[str, RehearsalOutcome]:
    """The newest outcome of each stop in a report's data; empty without a file."""
    if not file.exists():
        return {}
    outcomes = {}
    for line in file.read_text("utf-8").splitlines():
        row = json.loads(line)
        row["problems"] = tuple(row["problems"])
        outcomes[row["step"]] = RehearsalOutcome(**row)
    return outcomes


def append(file: Path, outcome: RehearsalOutcome) -> None:
    """Add an outcome to a report's data."""
    with file.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(asdict(outcome)) + "\n")


def next_step(outcomes: dict[str, RehearsalOutcome], serial: str) -> RehearsalStep | None:
    """The first stop that this arm has not passed; None: it has passed all."""
    for step in STEPS:
        found = outcomes.get(step.name)
        if found is None or found.problems or found.serial != serial:
            return step
    return None


def report(outcomes: dict[str, RehearsalOutcome], title: str) -> str:
    """The report as Markdown: every stop, measured against what is allowed."""
    lines = [
        f"# Rehearsal of {title}",
        "",
        f"Allowed: at rest within {1e3 * REST_S:.0f} ms, {1e3 * PIVOT_M:.1f} mm off the pivot, "
        "and no motion until a person starts the arm again.",
        "",
        "| stop | date | serial | at rest after | off the pivot | link | controller | verdict |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for step in STEPS:
        if (found := outcomes.get(step.name)) is None:
            lines.append(f"| {step.name} | – | – | – | – | – | – | missing |")
            continue
        lines.append(
            f"| {step.name} | {found.date} | {found.serial} | {_scaled(found.to_rest, 'ms')} | "
            f"{_scaled(found.deviation, 'mm')} | {found.condition} | {found.reason or '–'} | "
            f"{'; '.join(found.problems) or 'passed'} |"
        )
    return "\n".join(lines) + "\n"


def _scaled(value: float, unit: str) -> str:
    """Seconds or metres in thousandths."""
    if math.isnan(value):
        return "not measured"
    return f"{1e3 * value:.0f} {unit}" if unit == "ms" else f"{1e3 * value:.3f} {unit}"
