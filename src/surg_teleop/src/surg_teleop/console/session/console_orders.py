"""What the console asks of the system: values that the node turns into messages."""

from __future__ import annotations

from dataclasses import dataclass

from surg_teleop.console.web.page_protocol import Input


@dataclass(frozen=True)
class Move:
    """The hand, in time and from who drives: goes out on the leader's topics."""

    sample: Input


@dataclass(frozen=True)
class Present:
    """Whether the operator is there: `/console/operator_present`."""

    on: bool


@dataclass(frozen=True)
class Follow:
    """Teleoperation on or off: `/console/teleop/enable`."""

    on: bool


@dataclass(frozen=True)
class Clutch:
    """`/console/clutch`."""

    on: bool


@dataclass(frozen=True)
class Camera:
    """`/console/camera`."""

    on: bool


@dataclass(frozen=True)
class OtherMapping:
    """A tap of the button that changes between position and rate: `/console/rate`."""


@dataclass(frozen=True)
class SetScale:
    """`/console/teleop/set_scale`."""

    value: float


@dataclass(frozen=True)
class Record:
    """`/record/record`."""

    on: bool


@dataclass(frozen=True)
class Policy:
    """The arm to the connected policy, or back to nobody: `/policy/enable`."""

    on: bool


@dataclass(frozen=True)
class PutBack:
    """A simulated arm that is off its trocar is led home by hand: `/sim/by_hand`."""

    arm: str


@dataclass(frozen=True)
class StateCommand:
    """A word on an arm's `state_command`."""

    arm: str
    word: str


Order = (
    Move
    | Present
    | Follow
    | Clutch
    | Camera
    | OtherMapping
    | SetScale
    | Record
    | Policy
    | PutBack
    | StateCommand
)
