"""What a page may say: JSON texts in, checked values out. Nothing else of a page is believed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

LONGEST = 4096
"""[characters] of a message."""
REACH = 10.0
"""[m] largest coordinate of a handle; a page counts from zero."""
FASTEST = 0.2
"""[m/s] largest wanted speed of a tip, per axis."""
ROLL_REACH, ROLL_FASTEST = 1e3, 10.0
"""[rad], [rad/s]."""
SCALES = (0.05, 1.0)
"""Smallest and largest scale that the console offers."""
LAYOUTS = ("left", "stereo")
CODECS = ("h264", "jpeg")
HANDS = ("position", "rate")


class ProtocolError(ValueError):
    """A message that no page of ours sends: which key, what it was, what is allowed."""


@dataclass(frozen=True)
class Hello:
    """First words on every socket.

    Attributes:
        token: What the page was opened with; empty on loopback.
    """

    token: str


@dataclass(frozen=True)
class Input:
    """What the hand does now. In the view frame V: x right, y down, z away from the viewer.

    Attributes:
        seq: Counts up.
        at: The page's own steady clock [s].
        picture_us: Exposure stamp of the picture that the operator sees [µs]; 0: none yet.
        hand: "position" (mouse) or "rate" (keys, gamepad).
        p: (3,) the handle [m].
        roll: Of the handle about z [rad].
        v: (3,) wanted velocity of the tip [m/s].
        roll_rate: [rad/s].
        grip: 0 closed to 1 open; None: never touched.
        clutch: Whether it is held.
        camera: Whether it is held.
    """

    seq: int
    at: float
    picture_us: int = 0
    hand: str = "position"
    p: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll: float = 0.0
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll_rate: float = 0.0
    grip: float | None = None
    clutch: bool = False
    camera: bool = False


@dataclass(frozen=True)
class Press:
    """A button of the page.

    Attributes:
        button: One of `PRESSES`.
        at: The page's own steady clock [s].
    """

    button: str
    at: float


@dataclass(frozen=True)
class Scale:
    """How much of the hand's motion the tip makes."""

    value: float


@dataclass(frozen=True)
class Hidden:
    """The page can no longer be seen, or has lost its device.

    Attributes:
        why: One of `HIDDEN`.
    """

    why: str


@dataclass(frozen=True)
class Ping:
    """Asks for the server's clock.

    Attributes:
        at: Given back as it came.
    """

    at: float


@dataclass(frozen=True)
class Watch:
    """Which pictures a page wants."""

    layout: str
    codec: str


@dataclass(frozen=True)
class Shown:
    """The page has drawn a picture.

    Attributes:
        seq: Of the picture.
    """

    seq: int


Said = Hello | Input | Press | Scale | Hidden | Ping | Watch | Shown

PRESSES = ("take", "release", "enable", "stop", "record", "record_stop", "policy", "put_back")
HIDDEN = ("hidden", "closed", "gamepad", "pointer")


def parse(text: str) -> Said:
    """Read one message.

    Args:
        text: As it came from a page.

    Raises:
        ProtocolError: It is none; says which key, the value and what is allowed.
    """
    if len(text) > LONGEST:
        raise ProtocolError(f"a message of {len(text)} characters; allowed: {LONGEST}")
    try:
        found = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"no JSON: {error}") from error
    if not isinstance(found, dict):
        raise ProtocolError("a message is a JSON object")
    say = found.pop("say", None)
    reader = _READERS.get(say) if isinstance(say, str) else None
    if reader is None:
        raise ProtocolError(f"say: {_short(say)}; allowed: {', '.join(_READERS)}")
    said = reader(_Keys(found))
    if found:
        raise ProtocolError(f"{say}: unknown key {_short(next(iter(found)))}")
    return said


class _Keys:
    """Takes keys out of a message one by one."""

    def __init__(self, found: dict[str, Any]) -> None:
        self._found = found

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        value = self._found.pop(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ProtocolError(f"{key}: {_short(value)}; allowed: a number")
        if not low <= value <= high:  # also what is no number, and whole ones beyond any float
            raise ProtocolError(f"{key}: {_short(value)}; allowed: {low:g} to {high:g}")
        return float(value)

    def whole(self, key: str, high: int, default: int | None = None) -> int:
        value = self._found.pop(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= high:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: a whole number up to {high}")
        return value

    def vector(self, key: str, reach: float) -> tuple[float, float, float]:
        value = self._found.pop(key, [0.0, 0.0, 0.0])
        if not isinstance(value, list) or len(value) != 3:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: three numbers")
        x, y, z = (_Keys({key: each}).number(key, -reach, reach) for each in value)
        return x, y, z

    def flag(self, key: str) -> bool:
        value = self._found.pop(key, False)
        if not isinstance(value, bool):
            raise ProtocolError(f"{key}: {_short(value)}; allowed: true or false")
        return value

    def word(self, key: str, allowed: tuple[str, ...]) -> str:
        value = self._found.pop(key, None)
        if value not in allowed:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: {', '.join(allowed)}")
        return str(value)

    def text(self, key: str, longest: int) -> str:
        value = self._found.pop(key, "")
        if not isinstance(value, str) or len(value) > longest:
            raise ProtocolError(f"{key}: allowed: a text of up to {longest} characters")
        return value

    def grip(self) -> float | None:
        value = self._found.pop("grip", None)
        return None if value is None else _Keys({"grip": value}).number("grip", 0.0, 1.0)


_CLOCK = 1e10
"""[s] largest reading of a page's clock."""
_STAMP = 2**53


def _input(keys: _Keys) -> Input:
    return Input(
        seq=keys.whole("seq", _STAMP),
        at=keys.number("at", 0.0, _CLOCK),
        picture_us=keys.whole("picture_us", _STAMP, 0),
        hand=keys.word("hand", HANDS),
        p=keys.vector("p", REACH),
        roll=keys.number("roll", -ROLL_REACH, ROLL_REACH, 0.0),
        v=keys.vector("v", FASTEST),
        roll_rate=keys.number("roll_rate", -ROLL_FASTEST, ROLL_FASTEST, 0.0),
        grip=keys.grip(),
        clutch=keys.flag("clutch"),
        camera=keys.flag("camera"),
    )


_READERS: dict[str, Callable[[_Keys], Said]] = {
    "hello": lambda keys: Hello(keys.text("token", 256)),
    "input": _input,
    "press": lambda keys: Press(keys.word("button", PRESSES), keys.number("at", 0.0, _CLOCK)),
    "scale": lambda keys: Scale(keys.number("value", *SCALES)),
    "hidden": lambda keys: Hidden(keys.word("why", HIDDEN)),
    "ping": lambda keys: Ping(keys.number("at", 0.0, _CLOCK)),
    "watch": lambda keys: Watch(keys.word("layout", LAYOUTS), keys.word("codec", CODECS)),
    "shown": lambda keys: Shown(keys.whole("seq", 2**32)),
}


def _no_constant(name: str) -> float:
    raise ProtocolError(f"{name} is no number that may be sent")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "…"
