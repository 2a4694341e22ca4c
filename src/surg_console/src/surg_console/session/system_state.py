"""State of the running system as plain values, filled by the node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from surg_console.session.fixture_view import FixtureView
from surg_core import Reason


@dataclass(frozen=True)
class Arm:
    """State of one arm."""

    name: str
    state: str = ""  # DISABLED, ENABLED, PAUSED, FAULT; empty: unknown
    homed: bool = False
    heard: float = -1e9  # receipt of its last state, on the steady clock [s]
    reason: Reason | None = None  # why it is PAUSED or in FAULT; None: unknown
    warning: str = ""
    warned: float = -1e9  # receipt of that [s]

    def ready(self) -> bool:
        """Whether it is enabled and homed."""
        return self.state == "ENABLED" and self.homed


@dataclass(frozen=True)
class Follower:
    """State of one leader on one arm, from the teleoperation node."""

    state: str = ""  # DISABLED, WAITING, FOLLOWING, CLUTCHED, FAULT; empty: unknown
    reason: str = ""  # why the tip does not follow, or what limits it
    scale: float | None = None
    leader: str = ""
    arm: str = ""
    at_wall: bool = False  # the tip follows and is at a wall of its workspace


@dataclass(frozen=True)
class Gauges:
    """Live values of the driven arm; None: unknown."""

    rcm: float | None = None  # deviation from the trocar point [m]
    rcm_peak: float | None = None  # its largest value since the last report [m]
    depth: float | None = None  # of the tip behind the trocar [m]
    trocar: float | None = None  # force of the shaft on the trocar [N]
    tip: float | None = None  # force at the tip [N]
    clearance: float | None = None  # to other arms and obstacles [m]; None: no guard
    stop_tip: float | None = None  # most that the tip still moves, whatever stops the arm [m]
    stop_pivot: float | None = None  # most deviation from the trocar point until then [m]


@dataclass(frozen=True)
class Recorder:
    """State of the recorder."""

    state: str = ""  # IDLE, RECORDING, FINISHING; empty: no valid status
    problem: str = ""  # what is wrong with the recording
    finished: str = ""  # folder of the last episode that was finished; empty: none

    @property
    def recording(self) -> bool:
        """Whether an episode is open; its files may be under way."""
        return self.state in ("RECORDING", "FINISHING")


@dataclass(frozen=True)
class SimTask:
    """State of the phantom's task."""

    state: str = ""  # RUNNING, SUCCESS, FAILURE; NONE or empty: there is no task
    name: str = ""
    phase: str = ""
    detail: str = ""  # why it failed
    seed: int = 0  # of the episode


@dataclass(frozen=True)
class PolicyServer:
    """State of the model server."""

    state: str = ""  # IDLE, READY, WAKING, RUNNING, PAUSED; empty: no valid status
    name: str = ""
    detail: str = ""  # why it does not run
    refused: str = ""  # why the last enable was refused

    @property
    def active(self) -> bool:
        """Whether it has the arm, or is about to."""
        return self.state in ("WAKING", "RUNNING")

    @property
    def passive(self) -> bool:
        """Whether it states that it does not have the arm."""
        return self.state in ("IDLE", "READY", "PAUSED")


@dataclass(frozen=True)
class Drift:
    """How far instruments are seen beside the place where joints put them; None: unknown."""

    sentence: str  # for people
    least: float | None = None  # [m], 95 % interval
    expected: float | None = None  # [m]
    most: float | None = None  # [m]
    refusal: str = ""  # why nothing that trusts the picture may begin


@dataclass(frozen=True)
class Robot:
    """Everything at one moment. What has no valid, fresh status has its default value."""

    arms: tuple[Arm, ...] = ()  # the driven arm first, then what must be ready beside it
    follower: Follower = Follower()  # the operator's hand on the driven arm
    scope: Follower = Follower()  # the same hand on the endoscope's arm, where one holds it
    helpers: tuple[Follower, ...] = ()  # other hands on other arms
    gauges: Gauges = Gauges()
    fixtures: FixtureView | None = None  # of the driven arm; None: it has none
    recorder: Recorder = Recorder()
    simulated: bool = False  # whether a simulator moves the arms
    task: SimTask = SimTask()
    policy: PolicyServer = PolicyServer()
    calibration: dict[str, Any] | None = None  # see CalibrationStatus; None: no collector runs
    drift: Drift | None = None  # None: nobody watches the picture

    @property
    def ready(self) -> bool:
        """Whether every arm is enabled and homed."""
        return bool(self.arms) and all(arm.ready() for arm in self.arms)

    @property
    def faulted_arms(self) -> tuple[str, ...]:
        """Simulated arms in FAULT: nobody stands beside them who could put them back."""
        return tuple(a.name for a in self.arms if self.simulated and a.state == "FAULT")
