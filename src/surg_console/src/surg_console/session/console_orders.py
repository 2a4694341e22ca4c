"""Orders of the console; the node publishes each on its topic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from surg_console.web.page_protocol import Input


class Order:
    """What the console asks for."""


@dataclass(frozen=True)
class Move(Order):
    """An input of the page in control, for the leader's topics."""

    sample: Input


@dataclass(frozen=True)
class SetMapping(Order):
    """Toggle between position and rate control: a tap on `/console/rate`."""


@dataclass(frozen=True)
class StateCommand(Order):
    """A command on an arm's `state_command`."""

    arm: str
    word: str


@dataclass(frozen=True)
class Request(Order):
    """A value for a topic."""

    value: bool | float | str
    topic: ClassVar[str]


class EnableTeleop(Request):
    """Teleoperation on or off."""

    topic = "/console/teleop/enable"


class SetScale(Request):
    """Arm metres per metre of the hand."""

    topic = "/console/teleop/set_scale"


class Record(Request):
    """Recording on or off."""

    topic = "/record/record"


class Policy(Request):
    """The connected policy on or off."""

    topic = "/policy/enable"


class GuideHome(Request):
    """Name of a simulated arm in FAULT, to be guided home."""

    topic = "/sim/guide_home"


class Calibrate(Request):
    """A request to the collector of calibration views, by its name in CalibrationRequest."""

    topic = "/calibrate/request"


class Button(Request):
    """Whether a button is held; re-published, because receivers drop silent sources."""


class SetOperatorPresent(Button):
    """The operator is present."""

    topic = "/console/operator_present"


class Clutch(Button):
    """The clutch."""

    topic = "/console/clutch"


class Camera(Button):
    """The camera pedal."""

    topic = "/console/camera"
