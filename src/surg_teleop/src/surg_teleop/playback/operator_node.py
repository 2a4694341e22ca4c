"""Plays a motion file on one arm: a node that answers every control cycle.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm`` (PSM1), ``~motion`` (CSV; the bundled motion),
``~scale`` (1.0), ``~duration`` [s] (0: the motion once), ``~mode`` (cartesian | spherical),
``~lockstep`` (false), ``~realtime`` (priority; 0: none). Exit code 0: played to the end; 1:
stopped, with the reason on stderr and on ``~status``; 2: invalid file or parameter.
"""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import rospy

from surg_core import ConfigError, load_cell
from surg_core.arm_view import JawRange
from surg_core.contract import SECOND_NS
from surg_core.status_check import LatestStatus
from surg_msgs.msg import SenderStatus, SimStatus
from surg_ros.arm_port import ArmPort
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, flag, one_of, path, read, real, text, whole
from surg_ros.participant import Participant, TickInputs
from surg_ros.real_time import HIGHEST, prefer
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.playback.motion_file import MotionError, read_motion
from surg_teleop.playback.motion_path import MotionPlan
from surg_teleop.playback.motion_plan import ConstantMotionError, make_plan
from surg_teleop.playback.motion_player import Mode, MotionPlayer
from surg_teleop.playback.workspace_fit import Workspace

BUNDLED_MOTION = "motions/bundled.csv"
CONNECT_TIMEOUT = 30.0
"""[s] Longest wait for the controller and the robot link, wall clock."""
LINGER = 1.0
"""[s] Wait after the last message in free-run, wall clock, so that it leaves the socket."""


class OperatorNode:
    """Connects a MotionPlayer to the topics of one arm; sends nothing before :meth:`connect`."""

    def __init__(self, operator: MotionPlayer, arm: str, lockstep: bool) -> None:
        self.operator = operator
        self.finished = threading.Event()
        self._lockstep, self._stage = lockstep, operator.stage
        self._port = ArmPort(arm)
        self._sim = LatestStatus("/sim/status")
        self._status = rospy.Publisher("~status", SenderStatus, queue_size=10, latch=True)
        self._participant = Participant(
            {arm: self._port}, self._act, arms=(arm,), lockstep=lockstep
        )
        rospy.Subscriber("/sim/status", SimStatus, self._on_sim_status, queue_size=None)

    def connect(self) -> None:
        """Wait for every connection, then answer tick 1, which follows no cycle.

        Raises:
            TimeoutError: A connection is missing; states which.
            OSError: The master does not answer.
        """
        self._report()
        self._participant.connect(CONNECT_TIMEOUT)

    def _act(self, seen: TickInputs) -> bool:
        (arm,) = seen.cycles
        if not self.operator.done:
            self._port.send(self.operator.tick(seen.view(arm)))
        if self.operator.stage is not self._stage:
            self._stage = self.operator.stage
            self._report()
            if self.operator.done and not self._lockstep:
                self.finished.set()
        return self.operator.done

    def _on_sim_status(self, message: SimStatus) -> None:
        now = time.monotonic()
        self._sim.take(message, now)
        if complaint := self._sim.complaint(now):
            rospy.logwarn("operator: cannot tell when the run ends: %s", complaint)
        status = self._sim.at(now)  # None: invalid; it ends nothing
        if status is not None and status.state != SimStatus.STATE_RUNNING:
            self.finished.set()

    def _report(self) -> None:
        operator = self.operator
        message = SenderStatus(
            version=SenderStatus.VERSION,
            stage=getattr(SenderStatus, f"STAGE_{operator.stage.name}"),
            detail=operator.reason,
            refused=operator.refused,
            motion=str(operator.plan.motion.file),
            scale=operator.plan.scale,
            mode=operator.mode.value,
            duration=operator.plan.played,
        )
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
        if operator.started_ns:
            begin, end = operator.window_ns
            message.begin, message.end = _time(begin), _time(end)
        self._status.publish(message)


def _time(nanoseconds: int) -> rospy.Time:
    return rospy.Time(*divmod(nanoseconds, SECOND_NS))


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    cell: str = text()
    arm: str = text("PSM1")
    motion: Path | None = path(None)
    scale: float = real(default=1.0)
    duration: float = real(default=0.0)
    mode: str = one_of(tuple(mode.value for mode in Mode), "cartesian")
    lockstep: bool = flag(False)
    realtime: int = whole(0, HIGHEST, default=0)


def load(parameters: dict[str, object]) -> tuple[MotionPlayer, str, bool]:
    """Read every file once and check the motion before anything moves.

    Raises:
        ParamError: A parameter must not be used.
        ConfigError: The cell must not be used.
        MotionError: The motion must not be played.
    """
    given = read(Parameters, parameters)
    cell = load_cell(given.cell)
    if given.arm not in cell.arms:
        raise ParamError("arm", given.arm, f"the cell's arms: {', '.join(cell.arms)}")
    arm = cell.arms[given.arm]
    limits, instrument = arm.limits, arm.instrument
    motion = read_motion(given.motion or bundled_motion())
    if motion.ignored:
        rospy.logwarn("%s: columns ignored: %s", motion.file, ", ".join(motion.ignored))
    plan: MotionPlan = make_plan(
        motion,
        Workspace(limits.depth_slow, limits.depth_max, limits.cone),
        given.scale,
        given.duration or None,
    )
    operator = MotionPlayer(
        plan,
        Mode(given.mode),
        JawRange(instrument.jaw_min, instrument.jaw_max),
        StepLimits.of(limits, instrument.wrist.velocity if instrument.wrist else 0.0),
        instrument.wrist,
        limits.roll_max,
    )
    return operator, given.arm, given.lockstep


def bundled_motion() -> Path:
    """The motion that comes with the package, in a devel space or an install space."""
    import rospkg

    return Path(rospkg.RosPack().get_path("surg_teleop")) / BUNDLED_MOTION


def main() -> int:
    """Run the node; returns the exit code."""
    if not master_is_online("operator"):
        return 1
    rospy.init_node("operator")
    try:
        operator, arm, lockstep = load(dict(rospy.get_param("~", {})))
    except ConstantMotionError as error:
        print(f"operator: {error}", file=sys.stderr)
        return 1
    except (ParamError, ConfigError, MotionError) as error:
        print(f"operator: {error}", file=sys.stderr)
        return 2
    prefer(int(rospy.get_param("~realtime", 0)))
    node = OperatorNode(operator, arm, lockstep)
    try:
        node.connect()
    except OSError as error:
        print(f"operator: {error}", file=sys.stderr)
        return 1
    while not node.finished.wait(0.1) and not rospy.is_shutdown():
        pass
    if not rospy.is_shutdown():
        time.sleep(LINGER)
    if operator.reason:
        print(f"operator: stopped: {operator.reason}", file=sys.stderr)
        return 1
    return 0
