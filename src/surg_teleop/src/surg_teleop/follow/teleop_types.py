"""Values of the teleoperation: states, limits, settings and reasons."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from surg_core import WristConfig
from surg_core.arm_view import ArmCommands, ArmView, Array, JawRange
from surg_core.hand.leader_sample import HandlePose, HandRate, LeaderSample
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.wristed_tip import WristRange
from surg_teleop.playback.workspace_fit import Workspace

SILENCE = 0.1
"""[s] Timeout of the messages of leader, arm and camera."""
REQUEST_LIFETIME = 5.0
"""[s] A request to follow expires after this; enabling an arm takes a moment."""
RETRY = 0.5
"""[s] A state command that has shown no effect is sent again after this."""
ABANDONED = 2.0
"""[s] An arm whose leader is silent for longer is paused, and free for other senders."""
GRACE = 0.15
"""[s] An arm must obey the new stream within this time."""
MAX_LAG = 0.03
"""[m] Following ends when the arm is further behind its target."""
MAX_TURN_LAG = 1.0
"""[rad] The same of a wristed tool's turn. No tool can follow through its singular pose."""
NEUTRAL = 1e-3
"""[m/s], and ten times that [rad/s]: a rate leader below this is at rest."""
DEFAULT_SCALE = 0.2
MIN_SCALE, MAX_SCALE = 0.01, 1.0
_ROUNDING = 1e-9
"""[s] Tick times are not exact in binary; this keeps a deadline on its tick."""


def fresh(now: float, stamp: float) -> bool:
    """Whether a message of this stamp is within the timeout, both on the steady clock [s]."""
    return not older_than(SILENCE, now, stamp)


def older_than(limit: float, now: float, stamp: float) -> bool:
    """Whether a stamp is older than a limit [s]."""
    return now - stamp > limit + _ROUNDING


class TeleopState(enum.Enum):
    """State of one leader on one arm."""

    DISABLED = "DISABLED"
    WAITING = "WAITING"
    FOLLOWING = "FOLLOWING"
    CLUTCHED = "CLUTCHED"
    FAULT = "FAULT"


class ControlMode(enum.Enum):
    """How the leader drives the tip: by its position or by its rate."""

    POSITION = "position"
    RATE = "rate"

    def read(self, sample: LeaderSample) -> HandlePose | HandRate | None:
        """The part of a sample that this mode uses; None if the leader does not provide it."""
        return sample.pose if self is ControlMode.POSITION else sample.rate


class Reason(enum.Enum):
    """Why an arm does not follow, or what limits it."""

    NONE = ""
    ARM_SILENT = "arm_silent"
    ARM_FAULT = "arm_fault"
    ARM_NOT_READY = "arm_not_ready"
    ARM_HELD = "arm_held"
    ARM_BUSY = "arm_busy"
    ARM_STOPPING = "arm_stopping"
    LEADER_SILENT = "leader_silent"
    LEADER_PROBLEM = "leader_problem"
    LEADER_INVALID = "leader_invalid"
    LEADER_DEFLECTED = "leader_deflected"
    NO_SUCH_MODE = "no_such_mode"
    NOT_PRESENT = "not_present"
    CAMERA_SILENT = "camera_silent"
    CAMERA_INVALID = "camera_invalid"
    CAMERA_MOVED = "camera_moved"
    NODE_STALLED = "node_stalled"
    NOT_REQUESTED = "not_requested"
    TOO_SHALLOW = "too_shallow"
    NOT_OBEYING = "not_obeying"
    LAGGING = "lagging"
    HAND_JUMP = "hand_jump"
    AT_LIMIT = "at_limit"


@dataclass(frozen=True)
class Notice:
    """A reason with its message for the operator."""

    reason: Reason = Reason.NONE
    text: str = ""  # what is wrong and what to do; empty: nothing
    fault: bool = False  # latched: only ``enable`` clears it


@dataclass(frozen=True)
class CameraView:
    """Orientation of the endoscope's view."""

    R_WV: Array  # (3, 3) the view frame V, the left eye's optical axes, in the world of the cell
    received: float = math.inf  # receipt on the steady clock [s]; infinite for a fixed camera
    moved: str = ""  # why no hand may begin to follow in this view; empty: nothing has moved


@dataclass(frozen=True)
class TeleopSettings:
    """Constants of one leader on one arm."""

    leader: str  # name of the leader, for messages
    arm: str
    node: str  # caller id under which the commands are sent
    workspace: Workspace  # where the tip may be commanded
    step: StepLimits
    depth_inserted: float  # where the arm begins to take streams [m]
    # pause between ``hold`` and the next stream [s]; longer than the arm's ``servo_timeout``
    quiet: float = 0.15
    jaw: JawRange | None = None  # range of the jaw; None: the instrument has no jaw
    jaw_velocity: float = 3.0  # rate of the jaw once jaw and grip have met [rad/s]
    mode: ControlMode = ControlMode.POSITION  # the control mode at the start
    need_present: bool = False  # follow only while the operator is detected at the controls
    wrist: WristConfig | None = None  # None: the instrument is straight
    roll_max: float = math.inf  # end of a wristed instrument's roll [rad]

    def wrist_of(self, arm: ArmView) -> WristRange | None:
        """Kinematics of the arm's wrist; None: the instrument is straight.

        Raises:
            ValueError: The arm does not report its wrist.
        """
        if self.wrist is None:
            return None
        if arm.wrist is None:
            raise ValueError("the arm does not report its wrist")
        return WristRange(self.wrist, arm.wrist.geometry, self.roll_max)


@dataclass(frozen=True)
class TeleopInputs:
    """What one tick reads."""

    now: float  # steady clock [s]
    dt: float
    sample: LeaderSample | None
    valid: bool  # every number of the sample is finite, and its orientation is a rotation
    arm: ArmView | None
    camera: CameraView | None


@dataclass(frozen=True)
class TeleopOutput:
    """Result of one tick."""

    state: TeleopState
    commands: ArmCommands
    message: str  # why the arm does not follow, or what limits it, and what to do; may be empty
    reason: Reason = Reason.NONE
