"""Injectable faults, for tests and experiments.

A fault has a kind, an arm, a first tick and a duration. It is read from JSON, so that a parameter
or a message can state it::

    [{"fault": "freeze", "at": 600, "ticks": 30},
     {"fault": "wire", "topic": "robot/measured_js", "loss": 0.05, "burst": 3}]

``fault_injector`` applies them. The same seed, faults and commands give the same run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

from surg_core import RobotCondition
from surg_ros.params import ParamError, one_of, read, real, text, vector, whole

WIRES = ("robot/measured_js", "robot/servo_jv", "robot/servo_cv")
"""Topics whose packets can be lost, doubled and swapped. The two commands are one wire."""
FOREVER = 2**40
"""Ticks; longer than any run."""


class FaultError(ValueError):
    """An invalid fault; the message states where, the value and what is allowed."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Members of all faults."""

    kind: ClassVar[str] = ""
    arm: str = text("", empty=True)  # name of the arm; empty: the first one
    at: int = whole(0, FOREVER, 0)  # first tick with the fault; 0: the next tick


@dataclass(frozen=True, kw_only=True)
class Lasting(Fault):
    """A fault of limited duration."""

    ticks: int = whole(0, FOREVER, 0)  # duration [ticks of 2 ms]; 0: until the end of the run

    def active(self, tick: int) -> bool:
        """Whether it is active in this tick."""
        return self.at <= tick < self.at + (self.ticks or FOREVER)


@dataclass(frozen=True, kw_only=True)
class NotFinite(Lasting):
    """One joint is measured as not a number (F02)."""

    kind: ClassVar[str] = "not_finite"
    ticks: int = whole(0, FOREVER, 1)
    joint: int = whole(0, 15, 0)
    quantity: str = one_of(("position", "velocity"), "position")
    value: str = one_of(("nan", "inf", "-inf"), "nan")


@dataclass(frozen=True, kw_only=True)
class Freeze(Lasting):
    """The robot link freezes: it neither sends nor receives (F10).

    The drives continue, so that their dead-man timer runs. In lock-step every tick needs a state:
    the link repeats the last state with the new stamp.
    """

    kind: ClassVar[str] = "freeze"


@dataclass(frozen=True, kw_only=True)
class Wire(Lasting):
    """A channel that loses, duplicates and reorders packets (F11).

    In free-run the packets are lost, duplicated or late. In lock-step every tick has exactly one
    state and one answer: a receiver sees the newest content so far, and a lost answer counts as
    given but is not executed.
    """

    kind: ClassVar[str] = "wire"
    topic: str = one_of(WIRES, WIRES[0])
    loss: float = real(0.0, 1.0, 0.0)  # probability that a loss begins with a packet
    burst: int = whole(1, 500, 1)  # packets that one loss takes
    duplicate: float = real(0.0, 1.0, 0.0)  # probability that a packet arrives twice
    reorder: float = real(0.0, 1.0, 0.0)  # probability that it arrives behind its successor


@dataclass(frozen=True, kw_only=True)
class TrocarMotion(Fault):
    """The hole at rest begins a sinusoid from where it is, or stops where it is (amplitude 0)."""

    kind: ClassVar[str] = "trocar_motion"
    amplitude: float = real(0.0, 0.05)  # [m]
    frequency: float = real(0.0, 10.0, 0.25)  # [1/s]
    axis: tuple[float, float, float] = vector(3, (1.0, 0.0, 0.0))  # in the arm's base frame


@dataclass(frozen=True, kw_only=True)
class TrocarJump(Fault):
    """The hole at rest is displaced at once (F23)."""

    kind: ClassVar[str] = "trocar_jump"
    offset: tuple[float, float, float] = vector(3)  # [m] in the arm's base frame

    def __post_init__(self) -> None:
        """Refuse a jump that no patient's wall would survive."""
        if math.hypot(*self.offset) > 0.1:
            raise ParamError("offset", list(self.offset), "three numbers of length up to 0.1")


@dataclass(frozen=True, kw_only=True)
class TrackLost(Lasting):
    """The tracker of the trocar is silent: no ``rcm/track``."""

    kind: ClassVar[str] = "track_lost"


@dataclass(frozen=True, kw_only=True)
class ToolLost(Lasting):
    """The instrument's link is lost: no jaw angle, no command accepted (F31).

    In lock-step the jaw is reported as NaN, which means unknown.
    """

    kind: ClassVar[str] = "tool_lost"


CONDITIONS = tuple(
    name.lower() for name in RobotCondition.__members__ if name not in ("ACTIVE", "OTHER_COMMAND")
)
"""What a simulated robot can be instead of active."""


@dataclass(frozen=True, kw_only=True)
class RobotStop(Lasting):
    """The robot stops by itself, or obeys slower (F33); its link says why.

    Afterwards it is active again, as one that a person has unlocked and started.
    """

    kind: ClassVar[str] = "robot"
    condition: str = one_of(CONDITIONS, "stopped")
    scaling: float = real(0.0, 1.0, 0.5)  # of the speed, for "slowed"


@dataclass(frozen=True, kw_only=True)
class ToolOff(Fault):
    """The instrument is mounted with an error (calibration error); at the start only."""

    kind: ClassVar[str] = "tool_off"
    tip: float = real(0.0, 0.02, 0.001)  # displacement of the tip across the shaft [m]
    axis: float = real(0.0, 0.2, math.radians(0.5))  # turn of the shaft about the tip [rad]


_LASTING = (NotFinite, Freeze, Wire, TrackLost, ToolLost, RobotStop)
_KINDS: tuple[type[Fault], ...] = (*_LASTING, TrocarMotion, TrocarJump, ToolOff)
KINDS = {kind.kind: kind for kind in _KINDS}


def parse(text: str, arms: Sequence[str]) -> list[Fault]:
    """Read faults of the simulated arms from JSON: a list of objects, or one; empty: no fault.

    Raises:
        FaultError: The text is no JSON, or a fault in it must not be used.
    """
    if not text.strip():
        return []
    try:
        items = json.loads(text)
    except ValueError as error:
        raise FaultError(f"no JSON: {error}") from error
    items = items if isinstance(items, list) else [items]
    return [_read(item, f"fault {i + 1}", arms) for i, item in enumerate(items)]


def _read(item: Any, where: str, arms: Sequence[str]) -> Fault:
    if not isinstance(item, dict) or item.get("fault") not in KINDS:
        raise FaultError(f"{where} is {item!r}: 'fault' must be one of {', '.join(KINDS)}")
    kind = KINDS[item["fault"]]
    where = f"{where} ({kind.kind})"
    given = {name: value for name, value in item.items() if name != "fault"}
    known = [member.name for member in fields(kind)]
    for name in given:
        if name not in known:
            raise FaultError(f"{where} has no '{name}': allowed are {', '.join(known)}")
    try:
        fault = read(kind, given)
    except ParamError as error:
        stated = "is missing" if error.value is None else f"is {error.value!r}"
        raise FaultError(f"{where}, {error.name} {stated}: allowed is {error.allowed}") from error
    arm = fault.arm or arms[0]
    if arm not in arms:
        raise FaultError(f"{where}, arm is {arm!r}: allowed are {', '.join(arms)}")
    return replace(fault, arm=arm)
