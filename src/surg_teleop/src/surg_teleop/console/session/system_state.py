"""State of the running system as plain values, filled by the node."""

from __future__ import annotations

from dataclasses import dataclass

from surg_core import Reason


@dataclass(frozen=True)
class Arm:
    """State of one arm.

    Attributes:
        name: CRTK name.
        state: DISABLED, ENABLED, PAUSED, FAULT; empty: unknown.
        homed: Whether it is homed.
        heard: Receipt of its last state, on the steady clock [s].
        reason: Why it is PAUSED or in FAULT; None: unknown.
        warning: Its newest warning.
        warned: Receipt of that [s].
    """

    name: str
    state: str = ""
    homed: bool = False
    heard: float = -1e9
    reason: Reason | None = None
    warning: str = ""
    warned: float = -1e9

    def ready(self) -> bool:
        """Whether it is enabled and homed."""
        return self.state == "ENABLED" and self.homed


@dataclass(frozen=True)
class Follower:
    """State of one leader on one arm, from the teleoperation node.

    Attributes:
        state: DISABLED, WAITING, FOLLOWING, CLUTCHED, FAULT; empty: unknown.
        mapping: "position" or "rate".
        reason: Why the tip does not follow, or what limits it.
        scale: Motion scale.
        leader: Name of the leader.
        arm: Name of the arm.
    """

    state: str = ""
    mapping: str = "position"
    reason: str = ""
    scale: float | None = None
    leader: str = ""
    arm: str = ""

    @property
    def following(self) -> bool:
        """Whether the tip follows the hand."""
        return self.state == "FOLLOWING"


@dataclass(frozen=True)
class Gauges:
    """Live values of the driven arm; None: unknown.

    Attributes:
        rcm: Deviation from the trocar point [m].
        rcm_peak: Its largest value since the last report [m].
        depth: Of the tip behind the trocar [m].
        trocar: Force of the shaft on the trocar [N].
        tip: Force at the tip [N].
        age: Age of the values [s].
    """

    rcm: float | None = None
    rcm_peak: float | None = None
    depth: float | None = None
    trocar: float | None = None
    tip: float | None = None
    age: float | None = None


@dataclass(frozen=True)
class Recorder:
    """State of the recorder.

    Attributes:
        state: IDLE, RECORDING, FINISHING; empty: no valid status.
        problem: What is wrong with the recording.
    """

    state: str = ""
    problem: str = ""

    @property
    def recording(self) -> bool:
        """Whether an episode is open; its files may be under way."""
        return self.state in ("RECORDING", "FINISHING")


@dataclass(frozen=True)
class SimTask:
    """State of the phantom's task.

    Attributes:
        state: RUNNING, SUCCESS, FAILURE; NONE or empty: there is no task.
        name: Its name.
        phase: Phase of the task.
        detail: Why it failed.
    """

    state: str = ""
    name: str = ""
    phase: str = ""
    detail: str = ""


@dataclass(frozen=True)
class PolicyServer:
    """State of the model server.

    Attributes:
        state: IDLE, READY, WAKING, RUNNING, PAUSED; empty: no valid status.
        name: Name of the policy.
        detail: Why it does not run.
        refused: Why the last enable was refused.
    """

    state: str = ""
    name: str = ""
    detail: str = ""
    refused: str = ""

    @property
    def active(self) -> bool:
        """Whether it has the arm, or is about to."""
        return self.state in ("WAKING", "RUNNING")

    @property
    def passive(self) -> bool:
        """Whether it states that it does not have the arm."""
        return self.state in ("IDLE", "READY", "PAUSED")


@dataclass(frozen=True)
class Robot:
    """Everything at one moment. What has no valid, fresh status has its default value.

    Attributes:
        arms: The driven arm first, then what must be ready beside it.
        follower: The operator's hand on the driven arm.
        scope: The same hand on the endoscope's arm, where one holds it.
        helpers: Other hands on other arms.
        gauges: Of the driven arm.
        recorder: The recorder.
        simulated: Whether a simulator moves the arms.
        task: Its task.
        policy: The model server.
    """

    arms: tuple[Arm, ...] = ()
    follower: Follower = Follower()
    scope: Follower = Follower()
    helpers: tuple[Follower, ...] = ()
    gauges: Gauges = Gauges()
    recorder: Recorder = Recorder()
    simulated: bool = False
    task: SimTask = SimTask()
    policy: PolicyServer = PolicyServer()

    @property
    def astray(self) -> tuple[str, ...]:
        """Simulated arms in FAULT: nobody stands beside them who could put them back."""
        return tuple(a.name for a in self.arms if self.simulated and a.state == "FAULT")
