"""A CRTK client that behaves as the public Python ones do, written for the tests.

``Arm`` knows the convention and the dVRK's names and nothing of this project. What matters of the
public clients' behaviour is kept: every publisher must find a listener and every subscription a
sender before a script begins; a getter takes data that are young enough or waits one interval; a
move's handle takes the time before the command goes out, and its ``wait`` returns only when
``is_busy`` was seen true with a later stamp and is false again.

Time is a strategy. ``WallTime`` is what a script on a real arm has. ``LockstepTime`` makes the
client a declared participant: simulated time passes while it waits and stands still otherwise.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from crtk_msgs.msg import OperatingState, StringStamped
from surg_msgs.msg import Cycle, Ready
from surg_ros.byte_topics import listeners

Array = NDArray[np.float64]

INTERVAL = 0.02
"""How old data may be that a getter returns [s]."""
PATIENCE = 0.2
"""How long a getter waits for the next [s]."""
TICK = 0.002


class Time(Protocol):
    """What passes while clients wait."""

    changed: threading.Condition

    def now(self) -> float:
        """Seconds of the clock that stamps the arm's messages."""

    def until(self, met: Callable[[], bool], timeout: float) -> bool:
        """Let time pass until a condition holds; False when it does not within the time-out."""

    def count(self, arm: str) -> None:
        """A command has gone to an arm."""


class WallTime:
    """Real time."""

    def __init__(self) -> None:
        self.changed = threading.Condition()

    def now(self) -> float:
        """Wall clock [s]."""
        return rospy.Time.now().to_sec()

    def until(self, met: Callable[[], bool], timeout: float) -> bool:
        """Wait on the arm's messages."""
        with self.changed:
            return self.changed.wait_for(met, timeout)

    def count(self, arm: str) -> None:
        """Nobody counts in real time."""


class LockstepTime:
    """Simulated time: passes tick by tick, only while a client waits.

    Args:
        participant: The name under which controllers and simulator wait for this node.
        arms: Those that it commands.
    """

    def __init__(self, participant: str, *arms: str) -> None:
        self.changed = threading.Condition()
        self.tick = 0
        self._sent, self._done = dict.fromkeys(arms, 0), dict.fromkeys(arms, 0)
        self._name = participant.lstrip("/")
        self._ready = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
        keys: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
        self._cycles = [
            rospy.Subscriber(f"/{arm}/cycle", Cycle, self._on_cycle, arm, **keys) for arm in arms
        ]

    def connected(self) -> bool:
        """Whether simulator and controllers hear it, and it hears the controllers."""
        names = listeners(self._ready)  # one listener can be connected twice
        heard = {f"/{arm}/controller" for arm in self._done} < names
        return heard and all(cycle.get_num_connections() for cycle in self._cycles)

    def _on_cycle(self, message: Cycle, arm: str) -> None:
        with self.changed:
            self._done[arm] = message.tick
            self.changed.notify_all()

    def now(self) -> float:
        """Stamp of the last cycle [s]."""
        return self.tick * TICK

    def step(self) -> None:
        """One tick."""
        self.tick += 1
        arms, sent = list(self._sent), list(self._sent.values())
        self._ready.publish(Ready(tick=self.tick, participant=self._name, arms=arms, sent=sent))
        give_up = time.monotonic() + 60.0
        with self.changed:
            while not self.changed.wait_for(lambda: min(self._done.values()) >= self.tick, 0.2):
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException(f"shut down in tick {self.tick}")
                assert time.monotonic() < give_up, f"tick {self.tick}: cycles at {self._done}"

    def until(self, met: Callable[[], bool], timeout: float) -> bool:
        """Step while the condition does not hold."""
        for _ in range(round(timeout / TICK)):
            if met():
                return True
            self.step()
        return met()

    def count(self, arm: str) -> None:
        """The controller waits for what has been announced."""
        self._sent[arm] += 1

    def close(self) -> None:
        """Leave the graph."""
        for topic in (self._ready, *self._cycles):
            topic.unregister()


class Handle:
    """What a move returns."""

    def __init__(self, arm: Arm, start: float) -> None:
        self._arm, self._start = arm, start

    def wait(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Wait for the end of the move, or for its beginning; False: time-out."""
        return self._arm.wait_for_busy(is_busy, self._start, timeout)


class Group:
    """Topics below one name: an arm, its jaw, its local kinematics.

    Args:
        name: Namespace, such as ``PSM1`` or ``PSM1/jaw``.
        clock: What passes while it waits.
    """

    def __init__(self, name: str, clock: Time) -> None:
        self.name, self.time = name, clock
        self.newest: dict[str, Any] = {}
        self.publishers: list[rospy.Publisher] = []
        self.subscribers: list[rospy.Subscriber] = []

    def listen(self, topic: str, kind: type) -> None:
        """Keep the newest message of a topic."""

        def keep(message: Any) -> None:
            with self.time.changed:
                self.newest[topic] = message
                self.time.changed.notify_all()

        self.subscribers.append(rospy.Subscriber(f"/{self.name}/{topic}", kind, keep))

    def speak(self, topic: str, kind: type, counts: bool = True) -> Callable[[Any], None]:
        """A publisher; returns what sends a message."""
        publisher = rospy.Publisher(f"/{self.name}/{topic}", kind, queue_size=0, tcp_nodelay=True)
        self.publishers.append(publisher)

        def send(message: Any) -> None:
            publisher.publish(message)
            if counts:
                self.time.count(self.name.partition("/")[0])

        return send

    def get(self, topic: str, age: float = INTERVAL, wait: float = PATIENCE) -> Any:
        """The newest message of a topic, at most ``age`` old, or the next within ``wait``.

        Raises:
            TimeoutError: There is none, or it says that it is not valid.
        """
        known = self.newest.get(topic)
        old = known is None or self.time.now() - known.header.stamp.to_sec() > age
        if old and not self.time.until(lambda: self.newest.get(topic) is not known, wait):
            raise TimeoutError(f"/{self.name}/{topic}: no data within {wait} s")
        message = self.newest[topic]
        if message.header.stamp.is_zero():
            raise TimeoutError(f"/{self.name}/{topic}: not valid (stamp 0)")
        return message

    def unconnected(self) -> list[str]:
        """Topics that nobody listens to or nobody sends."""
        both: list[Any] = [*self.publishers, *self.subscribers]
        return [topic.name for topic in both if topic.get_num_connections() == 0]

    def close(self) -> None:
        """Leave the graph."""
        for topic in [*self.publishers, *self.subscribers]:
            topic.unregister()


class Jaw(Group):
    """The jaw of an instrument; its moves are waited for through the arm's state."""

    def __init__(self, arm: Arm) -> None:
        super().__init__(f"{arm.name}/jaw", arm.time)
        self._arm = arm
        self.servo_jf: Callable[[Any], None] | None = None  # the dVRK's only
        self.listen("measured_js", JointState)
        self.listen("setpoint_js", JointState)
        self._servo_jp = self.speak("servo_jp", JointState)
        self._move_jp = self.speak("move_jp", JointState)

    def servo_jp(self, angle: float) -> None:
        """Stream of angles [rad]."""
        self._servo_jp(JointState(position=[angle]))

    def move_jp(self, angle: float) -> Handle:
        """Go to an angle [rad]."""
        handle = Handle(self._arm, self.time.now())
        self._move_jp(JointState(position=[angle]))
        return handle

    def close_jaw(self) -> Handle:
        """Close as a dVRK script does: further than any jaw goes."""
        return self.move_jp(np.radians(-20.0))

    def open_jaw(self) -> Handle:
        """Open as a dVRK script does."""
        return self.move_jp(np.radians(60.0))


class Forces(Group):
    """What a dVRK client has below ``spatial`` and ``body``."""

    def __init__(self, arm: Arm, name: str) -> None:
        super().__init__(f"{arm.name}/{name}", arm.time)
        self.listen("measured_cf", WrenchStamped)
        self.listen("jacobian", Float64MultiArray)
        self.servo_cf = self.speak("servo_cf", WrenchStamped, counts=False)


class Arm(Group):
    """A PSM as a dVRK script sees it.

    Args:
        name: Its CRTK name.
        clock: What passes while it waits.
        dvrk: Also the topics that the dVRK's classes insist on and CRTK does not.
    """

    def __init__(self, name: str, clock: Time, dvrk: bool = False) -> None:
        super().__init__(name, clock)
        self.state = OperatingState()
        self._last_busy = -1.0
        self.busy_edges = 0
        self.subscribers.append(
            rospy.Subscriber(f"/{name}/operating_state", OperatingState, self._on_state)
        )
        for topic in ("measured_js", "setpoint_js"):
            self.listen(topic, JointState)
        for topic in ("measured_cp", "setpoint_cp"):
            self.listen(topic, PoseStamped)
        self.listen("measured_cv", TwistStamped)
        self._state_command = self.speak("state_command", StringStamped)
        self._hold = self.speak("hold", Empty)
        self._joints = {
            topic: self.speak(topic, JointState)
            for topic in ("servo_jp", "servo_jr", "move_jp", "move_jr")
        }
        self._poses = {topic: self.speak(topic, PoseStamped) for topic in ("servo_cp", "move_cp")}
        self._servo_cv = self.speak("servo_cv", TwistStamped)
        self.jaw = Jaw(self)
        self.groups: list[Group] = [self, self.jaw]
        self.words: list[str] = []
        if dvrk:
            self._add_dvrk()

    def _add_dvrk(self) -> None:
        local = Group(f"{self.name}/local", self.time)
        for topic in ("measured_cp", "setpoint_cp"):
            local.listen(topic, PoseStamped)
        self.listen("trajectory_j/ratio", Float64)
        self.spatial, self.body = Forces(self, "spatial"), Forces(self, "body")
        self.groups += [local, self.spatial, self.body]
        self.jaw.servo_jf = self.jaw.speak("servo_jf", JointState, counts=False)
        self.free = self.speak("free", Empty, counts=False)
        self.servo_jf = self.speak("servo_jf", JointState, counts=False)
        self.set_ratio = self.speak("trajectory_j/set_ratio", Float64, counts=False)
        self.use_gravity_compensation = self.speak("use_gravity_compensation", Bool, counts=False)
        self.set_absolute = self.speak("body/set_cf_orientation_absolute", Bool, counts=False)
        self.set_tool_present = self.speak("emulate_tool_present", Bool, counts=False)

    def check_connections(self, timeout: float = 10.0) -> None:
        """Give up where a topic has no other side.

        Raises:
            TimeoutError: Naming these topics.
        """
        end = time.monotonic() + timeout  # no simulated time passes before the start
        while missing := [name for group in self.groups for name in group.unconnected()]:
            if time.monotonic() > end:
                raise TimeoutError(f"no other side: {', '.join(missing)}")
            time.sleep(0.01)

    def close(self) -> None:
        """Leave the graph."""
        for group in self.groups[1:]:
            group.close()
        super().close()

    # --- state ------------------------------------------------------------------------------

    def _on_state(self, message: OperatingState) -> None:
        stamp = message.header.stamp.to_sec()
        with self.time.changed:
            if message.is_busy and stamp > self._last_busy:
                self.busy_edges += not self.state.is_busy
                self._last_busy = stamp
            if stamp > self.state.header.stamp.to_sec():
                self.state = message
            self.time.changed.notify_all()

    def _command(self, word: str, done: Callable[[], bool], timeout: float) -> bool:
        self.words.append(word)
        self._state_command(StringStamped(string=word))
        return self.time.until(done, timeout)

    def enable(self, timeout: float = 10.0) -> bool:
        """Switch on."""
        return self._command("enable", lambda: self.state.state == "ENABLED", timeout)

    def disable(self, timeout: float = 10.0) -> bool:
        """Switch off."""
        return self._command("disable", lambda: self.state.state == "DISABLED", timeout)

    def home(self, timeout: float = 10.0) -> bool:
        """Find home."""
        done = lambda: self.state.is_homed and not self.state.is_busy  # noqa: E731
        return self._command("home", done, timeout)

    def wait_for_busy(self, is_busy: bool, start: float, timeout: float) -> bool:
        """Wait until a move that began after ``start`` is under way, or has ended."""

        def met() -> bool:
            was = self._last_busy > start
            return was if is_busy else was and not self.state.is_busy

        return self.time.until(met, timeout)

    # --- motion -----------------------------------------------------------------------------

    def _move(self, send: Callable[[Any], None], message: Any) -> Handle:
        handle = Handle(self, self.time.now())
        send(message)
        return handle

    def servo_cp(self, pose: PoseStamped) -> None:
        """One pose of a stream."""
        self._poses["servo_cp"](_bare(pose))

    def move_cp(self, pose: PoseStamped) -> Handle:
        """Go to a pose."""
        return self._move(self._poses["move_cp"], _bare(pose))

    def servo_cv(self, linear: Sequence[float]) -> None:
        """One tip velocity [m/s] of a stream."""
        message = TwistStamped()
        message.twist.linear.x, message.twist.linear.y, message.twist.linear.z = linear
        self._servo_cv(message)

    def servo_jp(self, joints: Array) -> None:
        """One posture of a stream."""
        self._joints["servo_jp"](JointState(position=list(joints)))

    def move_jp(self, joints: Array) -> Handle:
        """Go to a posture."""
        return self._move(self._joints["move_jp"], JointState(position=list(joints)))

    def move_jr(self, change: Array) -> Handle:
        """Go on by a change of posture."""
        return self._move(self._joints["move_jr"], JointState(position=list(change)))

    def hold(self) -> None:
        """Stop and stay."""
        self._hold(Empty())

    # --- feedback ---------------------------------------------------------------------------

    def measured_jp(self) -> Array:
        """Measured joints."""
        return np.array(self.get("measured_js").position)

    def setpoint_jp(self) -> Array:
        """Joints that the arm shall have now."""
        return np.array(self.get("setpoint_js").position)

    def measured_cp(self) -> PoseStamped:
        """Measured pose."""
        return self.get("measured_cp")

    def setpoint_cp(self) -> PoseStamped:
        """Pose that the arm shall have now."""
        return self.get("setpoint_cp")

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.time.until(lambda: False, seconds)


def _bare(pose: PoseStamped) -> PoseStamped:
    """A pose as the public clients send it: no frame, no stamp."""
    message = PoseStamped()
    message.pose = pose.pose
    return message


def shifted(pose: PoseStamped, offset: Sequence[float]) -> PoseStamped:
    """The same pose some metres aside, the orientation left as it was."""
    moved = PoseStamped()
    moved.pose.orientation = pose.pose.orientation
    moved.pose.position.x = pose.pose.position.x + offset[0]
    moved.pose.position.y = pose.pose.position.y + offset[1]
    moved.pose.position.z = pose.pose.position.z + offset[2]
    return moved


def position(pose: PoseStamped) -> Array:
    """(3,) [m]."""
    p = pose.pose.position
    return np.array([p.x, p.y, p.z])
