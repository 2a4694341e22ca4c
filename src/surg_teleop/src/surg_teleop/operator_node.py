"""The operator as a node: plays a motion file into one arm, one answer per control cycle.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm`` (PSM1), ``~motion`` (CSV; the bundled motion),
``~scale`` (1.0), ``~duration`` [s] (0: the motion once), ``~mode`` (cartesian | spherical),
``~lockstep`` (false). Exit code 0: played to the end; 1: gave up, the reason is on stderr and on
``~status``; 2: a file or parameter that must not be used.
"""

from __future__ import annotations

import json
import os
import random
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from crtk_msgs.msg import StringStamped
from surg_core import ConfigError, load_cell, quaternion_xyzw_to_matrix
from surg_msgs.msg import Cycle, Ready
from surg_teleop.errors import MotionError
from surg_teleop.fit import Workspace
from surg_teleop.motion import read_motion
from surg_teleop.operator import (
    SECOND,
    ArmState,
    Commands,
    Feedback,
    Jaw,
    Mode,
    Operator,
    Pose,
)
from surg_teleop.peers import publishers, subscribers
from surg_teleop.plan import ConstantMotionError, Plan, make_plan

BUNDLED_MOTION = "motions/bundled.csv"
CONNECT_TIMEOUT = 30.0
"""[s] wall clock: longest wait for the controller and the robot link."""
LINGER = 1.0
"""[s] wall clock: after the last message in free-run, so that it leaves the socket."""
COMMANDS = {
    "state_command": StringStamped,
    "move_cp": PoseStamped,
    "servo_cp": PoseStamped,
    "servo_jp": JointState,
    "jaw/servo_jp": JointState,
    "hold": Empty,
}


class OperatorNode:
    """Wires an Operator to the topics of one arm."""

    def __init__(self, operator: Operator, arm: str, lockstep: bool) -> None:
        """Advertises and subscribes; nothing is sent before :meth:`connect`.

        Args:
            operator: What to play.
            arm: The arm's namespace, without slashes.
            lockstep: True: every tick is answered with Ready.
        """
        self.operator = operator
        self.finished = threading.Event()
        self._arm, self._lockstep = arm, lockstep
        self._lock = threading.Lock()
        self._tick, self._sent, self._stage = 0, 0, operator.stage
        self._jitter = float(os.environ.get("SURG_TEST_JITTER_MS", "0")) / 1e3
        self._out = {
            name: rospy.Publisher(f"/{arm}/{name}", kind, queue_size=0, tcp_nodelay=True)
            for name, kind in COMMANDS.items()
        }
        self._ready = rospy.Publisher(
            "/sim/ready", Ready, queue_size=0, tcp_nodelay=True, latch=True
        )
        self._status = rospy.Publisher("~status", String, queue_size=10, latch=True)
        self._cycle = rospy.Subscriber(
            f"/{arm}/cycle", Cycle, self._on_cycle, queue_size=None, tcp_nodelay=True
        )
        rospy.Subscriber("/sim/status", String, self._on_sim_status, queue_size=None)

    def connect(self) -> None:
        """Waits for every connection, then answers tick 1, which has no cycle before it.

        Raises:
            TimeoutError: Somebody is missing; says who.
            OSError: The master does not answer.
        """
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while missing := self._missing():
            if time.monotonic() > deadline or rospy.is_shutdown():
                raise TimeoutError(f"no connection after {CONNECT_TIMEOUT:.0f} s: {missing}")
            time.sleep(0.02)
        with self._lock:
            self._report()
            if self._lockstep and self._tick == 0:
                self._say_ready(1)

    def _missing(self) -> str:
        master, name = rosgraph.get_master_uri(), rospy.get_name()
        controllers = publishers(master, name, f"/{self._arm}/cycle")
        if not controllers:
            return f"nobody publishes /{self._arm}/cycle (is the controller running?)"
        if self._cycle.get_num_connections() == 0:
            return f"/{self._arm}/cycle is not connected yet"
        wanted = {f"/{self._arm}/{name}": controllers for name in self._out}
        if self._lockstep:
            links = publishers(master, name, f"/{self._arm}/robot/measured_js")
            if not links:
                return (
                    f"nobody publishes /{self._arm}/robot/measured_js (is the simulator running?)"
                )
            wanted["/sim/ready"] = controllers | links
        present = subscribers(rospy.get_node_uri(), name, wanted)
        for topic, nodes in wanted.items():
            if not nodes <= present[topic]:
                return f"{topic} does not reach {', '.join(sorted(nodes - present[topic]))}"
        return ""

    def _on_cycle(self, cycle: Cycle) -> None:
        with self._lock:
            if cycle.tick <= self._tick and self._tick > 0:
                return  # a repeated state: this tick has its answer
            self._tick = cycle.tick
            if self._lockstep and self._jitter > 0:
                time.sleep(random.uniform(0.0, self._jitter))
            if not self.operator.done:
                self._publish(self.operator.tick(feedback(cycle)))
            if self._lockstep:
                self._say_ready(cycle.tick + 1)
            if self.operator.stage is not self._stage:
                self._stage = self.operator.stage
                self._report()
                if self.operator.done and not self._lockstep:
                    self.finished.set()

    def _on_sim_status(self, message: String) -> None:
        try:
            status = json.loads(message.data)
        except ValueError:
            return
        if isinstance(status, dict) and (status.get("done") or status.get("aborted")):
            self.finished.set()

    def _publish(self, commands: Commands) -> None:
        stamp = rospy.Time(*divmod(commands.stamp_ns, SECOND))
        if commands.state is not None:
            self._send("state_command", StringStamped(string=commands.state), stamp)
        if commands.move_cp is not None:
            self._send("move_cp", pose_message(commands.move_cp), stamp)
        if commands.servo_cp is not None:
            self._send("servo_cp", pose_message(commands.servo_cp), stamp)
        if commands.servo_jp is not None:
            joints = JointState(
                name=["yaw", "pitch", "insertion", "roll"], position=commands.servo_jp.tolist()
            )
            self._send("servo_jp", joints, stamp)
        if commands.jaw is not None:
            self._send("jaw/servo_jp", JointState(name=["jaw"], position=[commands.jaw]), stamp)
        if commands.hold:
            self._out["hold"].publish(Empty())
            self._sent += 1

    def _send(
        self, name: str, message: StringStamped | PoseStamped | JointState, stamp: rospy.Time
    ) -> None:
        message.header.stamp = stamp
        self._out[name].publish(message)
        self._sent += 1

    def _say_ready(self, tick: int) -> None:
        self._ready.publish(
            Ready(
                tick=tick,
                participant="operator",
                arms=[self._arm],
                sent=[self._sent],
                done=self.operator.done,
            )
        )

    def _report(self) -> None:
        operator = self.operator
        self._status.publish(
            json.dumps(
                {
                    "stage": operator.stage.value,
                    "reason": operator.reason,
                    "refused": operator.refused,
                    "motion": operator.plan.motion.file,
                    "scale": operator.plan.mapping.scale,
                    "mode": operator.mode.value,
                    "duration_s": operator.plan.played,
                    "window_ns": list(operator.window_ns) if operator.started_ns else None,
                }
            )
        )


def feedback(cycle: Cycle) -> Feedback:
    """What the operator looks at in a cycle message, in the rcm frame."""
    R_RB = quaternion_xyzw_to_matrix(np.array(cycle.q_br)).T
    p_BRcm = np.array(cycle.p_rcm)
    return Feedback(
        stamp_ns=cycle.header.stamp.to_nsec(),
        state=ArmState(cycle.state),
        homed=cycle.homed,
        busy=cycle.busy,
        reason=cycle.reason,
        refused=cycle.refused,
        p_set=R_RB @ (np.array(cycle.p_set) - p_BRcm),
        p_tip=R_RB @ (np.array(cycle.p_tip) - p_BRcm),
    )


def pose_message(pose: Pose) -> PoseStamped:
    """A pose in the rcm frame as a message; an empty frame_id means that frame."""
    message = PoseStamped()
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.p.tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = pose.q.tolist()
    return message


def load(parameters: dict[str, object]) -> tuple[Operator, str, bool]:
    """Reads every file once and checks the motion before anything moves.

    Args:
        parameters: The node's private parameters.

    Returns:
        The operator, its arm's name, and whether it runs in lock-step.

    Raises:
        ConfigError: The cell or a parameter must not be used.
        MotionError: The motion must not be played.
    """
    unknown = sorted(
        set(parameters) - {"cell", "arm", "motion", "scale", "duration", "mode", "lockstep"}
    )
    if unknown or "cell" not in parameters:
        raise ConfigError(
            f"operator: parameter {', '.join(unknown) or '~cell'} "
            f"{'is unknown' if unknown else 'is missing'}; allowed: ~cell ~arm ~motion ~scale "
            "~duration ~mode ~lockstep"
        )
    cell = load_cell(str(parameters["cell"]))
    name = str(parameters.get("arm", "PSM1"))
    if name not in cell.arms:
        raise ConfigError(f"operator: ~arm: no arm '{name}'; the cell has {', '.join(cell.arms)}")
    modes = [mode.value for mode in Mode]
    mode = str(parameters.get("mode", "cartesian"))
    if mode not in modes:
        raise ConfigError(f"operator: ~mode: '{mode}'; allowed: {', '.join(modes)}")
    arm = cell.arms[name]
    limits, instrument = arm.limits, arm.instrument
    motion = read_motion(Path(str(parameters.get("motion") or bundled_motion())))
    if motion.ignored:
        rospy.logwarn("%s: columns ignored: %s", motion.file, ", ".join(motion.ignored))
    plan: Plan = make_plan(
        motion,
        Workspace(limits.depth_slow, limits.depth_max, limits.cone),
        number(parameters, "scale", 1.0),
        number(parameters, "duration", 0.0) or None,
    )
    operator = Operator(plan, Mode(mode), Jaw(instrument.jaw_min, instrument.jaw_max))
    return operator, name, bool(parameters.get("lockstep", False))


def number(parameters: dict[str, object], name: str, default: float) -> float:
    """A numeric parameter.

    Raises:
        ConfigError: It is not a number.
    """
    value = parameters.get(name, default)
    try:
        return float(str(value))
    except ValueError as error:
        raise ConfigError(f"operator: ~{name}: '{value}'; allowed: a number") from error


def bundled_motion() -> Path:
    """The motion that comes with the package, in a devel space or an install space."""
    import rospkg

    return Path(rospkg.RosPack().get_path("surg_teleop")) / BUNDLED_MOTION


def main() -> int:
    """Runs the node.

    Returns:
        The exit code.
    """
    if not rosgraph.is_master_online():
        print(
            f"operator: no ROS master at {rosgraph.get_master_uri()}; start one with 'rosmaster "
            "--core' or './surg up CELL'",
            file=sys.stderr,
        )
        return 1
    rospy.init_node("operator")
    try:
        operator, arm, lockstep = load(dict(rospy.get_param("~", {})))
    except ConstantMotionError as error:
        print(f"operator: {error}", file=sys.stderr)
        return 1
    except (ConfigError, MotionError) as error:
        print(f"operator: {error}", file=sys.stderr)
        return 2
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
        print(f"operator: gave up: {operator.reason}", file=sys.stderr)
        return 1
    return 0
