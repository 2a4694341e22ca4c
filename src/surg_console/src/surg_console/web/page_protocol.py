"""Messages of a page: JSON text in, checked values out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from surg_console.web.picture_packet import CODECS, LAYOUTS, WIDEST

LONGEST = 4096
"""[characters] Longest message."""
REACH = 10.0
"""[m] Largest coordinate of a handle; a page counts from zero."""
FASTEST = 0.2
"""[m/s] Largest speed of a tip, per axis."""
ROLL_FASTEST = 10.0
"""[rad/s]."""
SCALES = (0.05, 1.0)
"""Smallest and largest scale of the console."""
HANDS = ("position", "rate")
UNIT = 1e-3
"""Largest deviation of a quaternion's length from 1."""


class ProtocolError(ValueError):
    """An invalid message: key, value and what is allowed."""


@dataclass(frozen=True)
class Hello:
    """First message on every socket."""

    token: str  # from the page's address; empty on loopback


@dataclass(frozen=True)
class Input:
    """State of the hand in the view frame V: x right, y down, z away from the viewer."""

    seq: int
    at: float  # the page's own steady clock [s]
    picture_us: int = 0  # exposure stamp of the picture on the screen [µs]; 0: none yet
    hand: str = "position"  # "position" (mouse) or "rate" (keys, gamepad)
    p: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (3,) handle [m]
    # (4,) orientation of the handle, x y z w, whose third axis points out of the hand
    q: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (3,) velocity of the tip [m/s]
    roll_rate: float = 0.0  # [rad/s]
    tilt: tuple[float, float] = (0.0, 0.0)  # rates of a wrist about x and y [rad/s]
    grip: float | None = None  # 0 closed to 1 open; None: never touched
    clutch: bool = False  # the clutch is held
    camera: bool = False  # the camera pedal is held
    squeeze: bool | None = None  # a dead-man is held; None: the hand has none
    tracked: bool = True  # the headset sees the controller


@dataclass(frozen=True)
class Press:
    """A button of the page."""

    button: str  # one of `PRESSES`
    at: float  # the page's own steady clock [s]


@dataclass(frozen=True)
class Scale:
    """Motion scale."""

    value: float


@dataclass(frozen=True)
class Hidden:
    """The page is hidden, or has lost its input device."""

    why: str  # one of `HIDDEN`


@dataclass(frozen=True)
class Ping:
    """Requests the server's clock."""

    at: float  # returned unchanged


@dataclass(frozen=True)
class Watch:
    """Selects the pictures of a page."""

    layout: str
    codec: str
    spacing: int = 0  # between two pictures, at least [ms]


@dataclass(frozen=True)
class Shown:
    """The page has drawn a picture."""

    seq: int


@dataclass(frozen=True)
class CalibrationPress:
    """A button of the page /calibrate."""

    request: str  # one of `CALIBRATION_REQUESTS`, names of surg_msgs/CalibrationRequest


PageMessage = Hello | Input | Press | Scale | Hidden | Ping | Watch | Shown | CalibrationPress

JUDGEMENTS = ("success", "failure", "discard")
"""Of a person on the recording that has stopped."""
PRESSES = (
    *("take", "release", "enable", "stop", "record", "record_stop", "policy", "guide_home"),
    *("new_episode", *JUDGEMENTS),
)
CALIBRATION_REQUESTS = ("START_STEREO", "START_HANDEYE", "UNDO", "SOLVE")
HIDDEN = ("hidden", "closed", "gamepad", "pointer", "headset", "recentred")


def parse(text: str) -> PageMessage:
    """Read one message.

    Raises:
        ProtocolError: It is invalid; names key, value and what is allowed.
    """
    if len(text) > LONGEST:
        raise ProtocolError(f"a message of {len(text)} characters; allowed: {LONGEST}")
    try:
        fields = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"invalid JSON: {error}") from error
    if not isinstance(fields, dict):
        raise ProtocolError("a message is a JSON object")
    say = fields.pop("say", None)
    reader = _READERS.get(say) if isinstance(say, str) else None
    if reader is None:
        raise ProtocolError(f"say: {_short(say)}; allowed: {', '.join(_READERS)}")
    message = reader(_Keys(fields))
    if fields:
        raise ProtocolError(f"{say}: unknown key {_short(next(iter(fields)))}")
    return message


class _Keys:
    """Takes checked values out of a message."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self._fields = fields

    def has(self, key: str) -> bool:
        return key in self._fields

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        value = self._fields.pop(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ProtocolError(f"{key}: {_short(value)}; allowed: a number")
        if not low <= value <= high:  # also refuses NaN, and integers beyond any float
            raise ProtocolError(f"{key}: {_short(value)}; allowed: {low:g} to {high:g}")
        return float(value)

    def whole(self, key: str, high: int, default: int | None = None) -> int:
        value = self._fields.pop(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= high:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: a whole number up to {high}")
        return value

    def vector(self, key: str, reach: float) -> tuple[float, float, float]:
        value = self._fields.pop(key, [0.0, 0.0, 0.0])
        if not isinstance(value, list) or len(value) != 3:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: three numbers")
        x, y, z = (_Keys({key: item}).number(key, -reach, reach) for item in value)
        return x, y, z

    def quaternion(self, key: str) -> tuple[float, float, float, float]:
        value = self._fields.pop(key, [0.0, 0.0, 0.0, 1.0])
        if not isinstance(value, list) or len(value) != 4:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: four numbers")
        x, y, z, w = (_Keys({key: item}).number(key, -2.0, 2.0) for item in value)
        length = math.hypot(x, y, z, w)
        if not abs(length - 1.0) <= UNIT:
            raise ProtocolError(f"{key}: a quaternion of length {length:.4g}; allowed: 1")
        return x, y, z, w

    def flag(self, key: str, default: bool = False) -> bool:
        value = self._fields.pop(key, default)
        if not isinstance(value, bool):
            raise ProtocolError(f"{key}: {_short(value)}; allowed: true or false")
        return value

    def optional_flag(self, key: str) -> bool | None:
        return self.flag(key) if self._fields.get(key) is not None else self._fields.pop(key, None)

    def word(self, key: str, allowed: tuple[str, ...]) -> str:
        value = self._fields.pop(key, None)
        if value not in allowed:
            raise ProtocolError(f"{key}: {_short(value)}; allowed: {', '.join(allowed)}")
        return str(value)

    def text(self, key: str, longest: int) -> str:
        value = self._fields.pop(key, "")
        if not isinstance(value, str) or len(value) > longest:
            raise ProtocolError(f"{key}: allowed: a text of up to {longest} characters")
        return value

    def grip(self) -> float | None:
        value = self._fields.pop("grip", None)
        return None if value is None else _Keys({"grip": value}).number("grip", 0.0, 1.0)


_CLOCK = 1e10
"""[s] Largest reading of a page's clock."""
_STAMP = 2**53


def _input(keys: _Keys) -> Input:
    turned = keys.has("q")
    read = Input(
        seq=keys.whole("seq", _STAMP),
        at=keys.number("at", 0.0, _CLOCK),
        picture_us=keys.whole("picture_us", _STAMP, 0),
        hand=keys.word("hand", HANDS),
        p=keys.vector("p", REACH),
        q=keys.quaternion("q"),
        v=keys.vector("v", FASTEST),
        roll_rate=keys.number("roll_rate", -ROLL_FASTEST, ROLL_FASTEST, 0.0),
        tilt=(
            keys.number("tilt_x", -ROLL_FASTEST, ROLL_FASTEST, 0.0),
            keys.number("tilt_y", -ROLL_FASTEST, ROLL_FASTEST, 0.0),
        ),
        grip=keys.grip(),
        clutch=keys.flag("clutch"),
        camera=keys.flag("camera"),
        squeeze=keys.optional_flag("squeeze"),
        tracked=keys.flag("tracked", True),
    )
    if read.squeeze is not None and (read.hand != "position" or not turned):
        raise ProtocolError("squeeze: allowed with hand position and q only")
    return read


_READERS: dict[str, Callable[[_Keys], PageMessage]] = {
    "hello": lambda keys: Hello(keys.text("token", 256)),
    "input": _input,
    "press": lambda keys: Press(keys.word("button", PRESSES), keys.number("at", 0.0, _CLOCK)),
    "scale": lambda keys: Scale(keys.number("value", *SCALES)),
    "hidden": lambda keys: Hidden(keys.word("why", HIDDEN)),
    "ping": lambda keys: Ping(keys.number("at", 0.0, _CLOCK)),
    "watch": lambda keys: Watch(
        keys.word("layout", LAYOUTS),
        keys.word("codec", CODECS),
        keys.whole("spacing", WIDEST, 0),
    ),
    "calibrate": lambda keys: CalibrationPress(keys.word("request", CALIBRATION_REQUESTS)),
    "shown": lambda keys: Shown(keys.whole("seq", 2**32)),
}


def _no_constant(name: str) -> float:
    raise ProtocolError(f"{name} is not allowed; allowed: finite numbers")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "…"
