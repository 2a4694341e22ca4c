"""Orders of the console; the node turns them into messages."""

from __future__ import annotations

from dataclasses import dataclass

from surg_teleop.console.web.page_protocol import Input


@dataclass(frozen=True)
class Move:
    """An input of the page in control, for the leader's topics."""

    sample: Input


@dataclass(frozen=True)
class Present:
    """Whether the operator is present: `/console/operator_present`."""

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
    """Toggle between position and rate control: `/console/rate`."""


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
    """Start or stop the connected policy: `/policy/enable`."""

    on: bool


@dataclass(frozen=True)
class PutBack:
    """Guide a simulated arm in FAULT home: `/sim/by_hand`."""

    arm: str


@dataclass(frozen=True)
class StateCommand:
    """A command on an arm's `state_command`."""

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
