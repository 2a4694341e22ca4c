"""Injectable faults, for tests and experiments.

A fault has a kind, an arm, a first tick and a duration. It is read from JSON, so that a parameter
or a message can state it::

    [{"fault": "freeze", "at": 600, "ticks": 30},
     {"fault": "wire", "topic": "robot/measured_js", "loss": 0.05, "burst": 3}]

``injector`` applies them. The same seed, faults and commands give the same run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar

WIRES = ("robot/measured_js", "robot/servo_jv", "robot/servo_cv")
"""Topics whose packets can be lost, doubled and swapped. The two commands are one wire."""
FOREVER = 2**40
"""Ticks; longer than any run."""


class FaultError(ValueError):
    """An invalid fault; the message states where, the value and what is allowed."""


def _number(low: float, high: float, default: float | None = None) -> Any:
    meta = {"low": low, "high": high, "whole": False}
    return field(metadata=meta) if default is None else field(default=default, metadata=meta)


def _count(low: int, high: int, default: int) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "whole": True})


def _word(allowed: Sequence[str], default: str) -> Any:
    return field(default=default, metadata={"allowed": allowed})


def _vector(limit: float, default: tuple[float, float, float] | None = None) -> Any:
    meta = {"vector": limit}
    return field(metadata=meta) if default is None else field(default=default, metadata=meta)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Members of all faults."""

    kind: ClassVar[str] = ""
    arm: str = ""  # name of the arm; empty: the first one
    at: int = _count(0, FOREVER, 0)  # first tick with the fault; 0: the next tick


@dataclass(frozen=True, kw_only=True)
class Lasting(Fault):
    """A fault of limited duration."""

    ticks: int = _count(0, FOREVER, 0)  # duration [ticks of 2 ms]; 0: until the end of the run

    def active(self, tick: int) -> bool:
        """Whether it is active in this tick."""
        return self.at <= tick < self.at + (self.ticks or FOREVER)


@dataclass(frozen=True, kw_only=True)
class NotFinite(Lasting):
    """One joint is measured as not a number (F02)."""

    kind: ClassVar[str] = "not_finite"
    ticks: int = _count(0, FOREVER, 1)
    joint: int = _count(0, 15, 0)  # index of the joint
    quantity: str = _word(("position", "velocity"), "position")  # the affected quantity
    value: str = _word(("nan", "inf", "-inf"), "nan")  # the value reported instead


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
    topic: str = _word(WIRES, WIRES[0])  # the wire
    loss: float = _number(0.0, 1.0, 0.0)  # probability that a loss begins with a packet
    burst: int = _count(1, 500, 1)  # packets that one loss takes
    duplicate: float = _number(0.0, 1.0, 0.0)  # probability that a packet arrives twice
    # Probability that a packet arrives behind its successor.
    reorder: float = _number(0.0, 1.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class TrocarMotion(Fault):
    """The hole at rest begins a sinusoid from where it is, or stops where it is (amplitude 0)."""

    kind: ClassVar[str] = "trocar_motion"
    amplitude: float = _number(0.0, 0.05)  # [m]
    frequency: float = _number(0.0, 10.0, 0.25)  # [1/s]
    # Direction in the arm's base frame.
    axis: tuple[float, float, float] = _vector(1e6, (1.0, 0.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class TrocarJump(Fault):
    """The hole at rest is displaced at once (F23)."""

    kind: ClassVar[str] = "trocar_jump"
    offset: tuple[float, float, float] = _vector(0.1)  # [m] in the arm's base frame


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


@dataclass(frozen=True, kw_only=True)
class ToolOff(Fault):
    """The instrument is mounted with an error (calibration error); at the start only."""

    kind: ClassVar[str] = "tool_off"
    tip: float = _number(0.0, 0.02, 0.001)  # displacement of the tip across the shaft [m]
    axis: float = _number(0.0, 0.2, math.radians(0.5))  # turn of the shaft about the tip [rad]


_KINDS: tuple[type[Fault], ...] = (
    NotFinite,
    Freeze,
    Wire,
    TrocarMotion,
    TrocarJump,
    TrackLost,
    ToolLost,
    ToolOff,
)
KINDS = {kind.kind: kind for kind in _KINDS}


def parse(text: str, arms: Sequence[str]) -> list[Fault]:
    """Read faults from JSON: a list of objects, or one object.

    Args:
        text: The JSON text; empty: no fault.
        arms: Names of the simulated arms.

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
    known = {f.name: f for f in fields(kind)}
    where = f"{where} ({kind.kind})"
    values: dict[str, Any] = {}
    for name, value in item.items():
        if name == "fault":
            continue
        if name not in known:
            raise FaultError(f"{where} has no '{name}': allowed are {', '.join(known)}")
        values[name] = _check(f"{where}, {name}", value, known[name].metadata)
    missing = [n for n, f in known.items() if f.default is MISSING and n not in values]
    if missing:
        raise FaultError(f"{where} needs {', '.join(missing)}")
    arm = values.setdefault("arm", "") or arms[0]
    if arm not in arms:
        raise FaultError(f"{where}, arm is {arm!r}: allowed are {', '.join(arms)}")
    values["arm"] = arm
    return kind(**values)


def _check(where: str, value: Any, meta: Any) -> Any:
    if "allowed" in meta:
        if value not in meta["allowed"]:
            raise FaultError(f"{where} is {value!r}: allowed are {', '.join(meta['allowed'])}")
    elif "vector" in meta:
        limit = meta["vector"]
        good = isinstance(value, list) and len(value) == 3 and all(map(_is_real, value))
        length = math.hypot(*value) if good else 0.0
        if not good or not 0.0 < length <= limit:
            raise FaultError(
                f"{where} is {value!r}: three numbers, not all zero, of length up to {limit}"
            )
        return tuple(float(v) for v in value)
    elif "low" in meta:
        low, high = meta["low"], meta["high"]
        whole = meta["whole"] and not isinstance(value, int)
        if not _is_real(value) or whole or not low <= value <= high:
            what = "a whole number" if meta["whole"] else "a number"
            raise FaultError(f"{where} is {value!r}: {what} from {low} to {high} is allowed")
        return value if meta["whole"] else float(value)
    elif not isinstance(value, str):
        raise FaultError(f"{where} is {value!r}: a text is needed")
    return value


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
