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
class StateCommand(Order):
    """A command on an arm's `state_command`."""

    arm: str
    word: str


@dataclass(frozen=True)
class Request(Order):
    """A value for a topic."""

    value: bool | float | str
    topic: ClassVar[str]

    def __init_subclass__(cls, topic: str = "") -> None:
        cls.topic = topic


class EnableTeleop(Request, topic="/console/teleop/enable"):
    """Teleoperation on or off."""


class SetMapping(Request, topic="/console/teleop/set_rate_control"):
    """How the hand drives the tip; true: by its rate, false: by its position."""


class SetScale(Request, topic="/console/teleop/set_scale"):
    """Arm metres per metre of the hand."""


class Record(Request, topic="/record/record"):
    """Recording on or off."""


class Describe(Request, topic="/record/info"):
    """Facts of the episode to be recorded, as JSON."""


class NewEpisode(Request, topic="/sim/new_episode"):
    """Another episode of the simulator's task; without a value."""


class Policy(Request, topic="/policy/enable"):
    """The connected policy on or off."""


class GuideHome(Request, topic="/sim/guide_home"):
    """Name of a simulated arm in FAULT, to be guided home."""


class Calibrate(Request, topic="/calibrate/request"):
    """A request to the collector of calibration views, by its name in CalibrationRequest."""


class Button(Request):
    """Whether a button is held; re-published, because receivers drop silent sources."""


class SetOperatorPresent(Button, topic="/console/operator_present"):
    """The operator is present."""


class Clutch(Button, topic="/console/clutch"):
    """The clutch."""


class Camera(Button, topic="/console/camera"):
    """The camera pedal."""
