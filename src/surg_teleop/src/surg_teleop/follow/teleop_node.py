"""Teleoperation as a node: hands on the controls of one cell (docs/reference/teleoperation.md).

Parameters: ``~cell`` (folder or cell.yaml); ``~leader`` (a bundled leader, an entry point, a
``.py`` file, or ``crtk`` for topics), ``~settings`` (of the leader, a mapping), ``~arm`` (PSM1),
``~mapping`` (position | rate), ``~scale`` (0.2), ``~need_present`` (false); the same for a second
hand with the prefix ``second_``, whose arm may be ``assistant``, with ``~assistant_frame`` (x, y,
z, w of its trocar frame in the world); ``~view`` (x, y, z, w of the view in the world, for an
endoscope that no arm holds); ``~picture`` (/endoscope/left/image_raw; empty: not watched);
``~lockstep`` (false), and with it ``~enabled`` (false: somebody must enable) and ``~duration`` [s]
(done after it). Exit code 1: a connection is missing, or the end hung; 2: a file or parameter that
must not be used.
"""

from __future__ import annotations

import math
import os
import signal
import struct
import sys
import threading
import time
import zlib
from typing import Any

import numpy as np
import rosgraph
import rospy
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool, Float64, String

from crtk_msgs.msg import StringStamped
from surg_core import ConfigError
from surg_core.arm_view import ArmView
from surg_core.contract import SECOND_NS, TICK_NS
from surg_msgs.msg import Cycle, HandStatus, TeleopStatus
from surg_ros.arm_port import KINDS, SERVO_INSTRUMENT, ArmPort, arm_view
from surg_ros.params import ParamError
from surg_ros.participant import Participant, Seen
from surg_ros.transport.polled_subscriber import PolledSubscriber
from surg_ros.transport.raw_message import RawCycle
from surg_teleop.follow.endoscope_pose import HeldCamera
from surg_teleop.follow.message_lateness import Arrivals
from surg_teleop.follow.pedal_monitor import PedalMonitor
from surg_teleop.follow.picture_watch import PictureWatch
from surg_teleop.follow.teleop_setup import ASSISTANT, Hand, TeleopSetup, read_setup
from surg_teleop.follow.teleop_types import CameraView, State, TeleopOutput
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.crtk_leader_node import CrtkTopics
from surg_teleop.leaders.leader import LeaderError

ASKED_PERIOD = 0.004
"""[s] A leader that must be asked is asked that often."""
HEARD_PERIOD = 0.010
"""[s] Leaders that speak begin a tick at once; in their pauses time passes that often."""
AGAIN = 1.0
"""[s] The same warning is said no more often."""
REPORT = 0.5
"""[s] ``~status`` is said at least that often."""
CONNECT_TIMEOUT = 30.0
"""[s] wall clock, lock-step: longest wait for everybody."""
END = 2.0
"""[s] from being told to end until the process is gone, whatever hangs."""
PEDALS = {"clutch": "clutch", "camera": "camera", "operator_present": "present", "rate": "rate"}


class TeleopNode:
    """Wires hands, arms and the camera; every decision is :class:`Teleop`'s."""

    def __init__(self, system: TeleopSetup) -> None:
        """Advertises and subscribes.

        Args:
            system: What the parameters say.
        """
        self._system = system
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self.finished = threading.Event()
        """Set where the node shall end."""
        self._pedals = PedalMonitor()
        self._cycles: dict[str, tuple[float, RawCycle]] = {}
        self._arrivals = {arm: Arrivals() for arm in system.heard}
        self._recording = False
        self._status: tuple[object, ...] = ()
        self._picture_problem: str | None = None
        self._reported = -math.inf
        self._picture = PictureWatch(system.picture)
        self._latched: dict[tuple[str, str], rospy.Publisher] = {}
        self._said: dict[tuple[str, str], object] = {}
        self._warned: dict[str, float] = {}
        self._ports = {name: ArmPort(name, tuple(KINDS)) for name in system.bases}
        if system.assistant is not None:
            self._ports[ASSISTANT] = ArmPort(ASSISTANT, SERVO_INSTRUMENT)
        self._warning = rospy.Publisher("~warning", String, queue_size=10)
        self._report = rospy.Publisher("~status", TeleopStatus, queue_size=2, latch=True)
        self._record = rospy.Publisher("/record/record", Bool, queue_size=2)
        # In free-run hands are moved less often than arms speak: each reads the newest cycle then.
        self._polled: dict[str, PolledSubscriber] = {}
        if system.lockstep:
            self._participant = Participant(
                self._ports, self._on_tick, system.heard, lock=self._lock
            )
        else:
            self._polled = {
                arm: PolledSubscriber(f"/{arm}/cycle", RawCycle) for arm in system.heard
            }
        for hand in system.hands:
            self._wire_hand(hand)
            if isinstance(hand.leader, CrtkLeader):
                CrtkTopics(hand.leader, self._lock, self._wake)
        self._wire_console()
        if system.assistant is not None:
            _listen(f"/{ASSISTANT}/measured_js", JointState, self._on_assistant)
            _listen(f"/{ASSISTANT}/jaw/measured_js", JointState, self._on_assistant_jaw)
        if system.picture:
            _listen(system.picture, rospy.AnyMsg, self._on_picture)

    # Topics.

    def _wire_hand(self, hand: Hand) -> None:
        for arm, one in hand.switch.arms.items():
            pair = f"/{hand.leader.name}_{arm}"
            kinds = {
                "current_state": String,
                "desired_state": String,
                "following": Bool,
                "scale": Float64,
                "rotation_locked": Bool,
                "translation_locked": Bool,
            }
            for name, kind in kinds.items():
                self._latched[arm, name] = rospy.Publisher(
                    f"{pair}/{name}", kind, queue_size=10, latch=True
                )
            _listen(f"{pair}/state_command", StringStamped, self._on_state_command, one)
            _listen(f"{pair}/set_scale", Float64, self._on_scale, [one])
            _listen(f"{pair}/lock_rotation", Bool, self._on_lock, (one, "lock_rotation"))
            _listen(f"{pair}/lock_translation", Bool, self._on_lock, (one, "lock_translation"))

    def _wire_console(self) -> None:
        everyone = [one for hand in self._system.hands for one in hand.switch.arms.values()]
        for source in ("/console", "/footpedals"):
            for topic, button in PEDALS.items():
                _listen(f"{source}/{topic}", Joy, self._on_pedal, (source, button))
        _listen("/console/teleop/enable", Bool, self._on_enable)
        _listen("/console/teleop/set_scale", Float64, self._on_scale, everyone)
        _listen("/record/recording", Bool, self._on_recording)

    def _keep_cycle(self, message: RawCycle, arm: str) -> None:
        # A cycle that a network held up is as old as it is, not as new as it came.
        received = self._arrivals[arm].of(message.stamp(), time.monotonic())
        self._cycles[arm] = (received, message)

    def _on_pedal(self, message: Joy, which: tuple[str, str]) -> None:
        with self._lock:
            # Two senders on one topic are two feet: neither lifts the other's.
            source = f"{message._connection_header['callerid']} ({which[0]})"
            down = bool(message.buttons) and message.buttons[0] == 1
            news = self._pedals.press(source, which[1], down, time.monotonic())
        if news:
            self._wake.set()

    def _on_enable(self, message: Bool) -> None:
        with self._lock:
            for hand in self._system.hands:
                self._switch(hand, bool(message.data))
        self._wake.set()

    def _on_state_command(self, message: StringStamped, one: Teleop) -> None:
        with self._lock:
            if message.string == "enable":
                self._pedals.forget(time.monotonic())
                one.enable()
            elif message.string == "disable":
                one.disable()
            else:
                self._warn(f"state_command '{message.string}'; allowed: enable, disable")

    def _on_scale(self, message: Float64, whose: list[Teleop]) -> None:
        with self._lock:
            for refused in {text for one in whose if (text := one.set_scale(message.data))}:
                self._warn(refused)

    def _on_lock(self, message: Bool, which: tuple[Teleop, str]) -> None:
        with self._lock:
            setattr(*which, bool(message.data))

    def _on_recording(self, message: Bool) -> None:
        self._recording = bool(message.data)

    def _on_assistant(self, message: JointState) -> None:
        assistant = self._system.assistant
        assert assistant is not None
        with self._lock:
            stamp = message.header.stamp.to_nsec()
            assistant.joints(time.monotonic(), stamp, np.array(message.position))

    def _on_assistant_jaw(self, message: JointState) -> None:
        assistant = self._system.assistant
        assert assistant is not None
        if message.position:
            with self._lock:
                assistant.jaw(message.position[0])

    def _on_picture(self, message: rospy.AnyMsg) -> None:
        # Header: sequence, seconds, nanoseconds, frame_id; the pixels need not be unpacked.
        data = memoryview(message._buff)
        seconds, nanoseconds = np.frombuffer(data[4:12], "<u4").tolist()
        frame = 16 + int(np.frombuffer(data[12:16], "<u4")[0])
        with self._lock:
            self._picture.picture(
                time.monotonic(), seconds * SECOND_NS + nanoseconds, zlib.crc32(data[frame:])
            )

    # Ticks.

    def run(self) -> None:
        """Free-run: a tick whenever a leader speaks, and every period, until ``finished``."""
        heard = all(isinstance(hand.leader, CrtkLeader) for hand in self._system.hands)
        period = HEARD_PERIOD if heard else ASKED_PERIOD
        while not self.finished.is_set() and not rospy.is_shutdown():
            self._wake.wait(period)
            self._wake.clear()
            with self._lock:
                self._act(time.monotonic())

    def stop(self) -> None:
        """Lets go of everything that follows; no exit leaves an arm moving."""
        with self._lock:
            if not self._system.lockstep:
                for hand in self._system.hands:
                    hand.switch.disable()
                self._act(time.monotonic())
            for hand in self._system.hands:
                hand.leader.close()

    def _on_tick(self, seen: Seen) -> bool | None:
        """Lock-step: the cycles of all arms are here; with the lock held."""
        if self.finished.is_set():
            return None
        now = seen.tick * TICK_NS / SECOND_NS
        self._cycles = {name: (now, raw) for name, raw in seen.cycles.items()}
        self._act(now)
        done = 0.0 < self._system.duration <= now
        if done:
            self.finished.set()
        return done

    def _act(self, now: float) -> None:
        system = self._system
        for arm, polled in self._polled.items():
            if messages := polled.fetch():
                try:
                    self._keep_cycle(RawCycle().deserialize(messages[-1]), arm)
                except struct.error as error:
                    rospy.logwarn_throttle(1.0, f"/{arm}/cycle: unreadable message: {error}")
        cycles = {name: (received, raw.read()) for name, (received, raw) in self._cycles.items()}
        views = {
            name: arm_view(cycle, system.bases[name], received)
            for name, (received, cycle) in cycles.items()
            if name in system.bases
        }
        if system.assistant is not None and (view := system.assistant.view()) is not None:
            views[ASSISTANT] = view
        camera = self._camera(cycles)
        for hand in system.hands:
            self._move(hand, now, views, camera)
        self._tell(now)

    def _camera(self, cycles: dict[str, tuple[float, Cycle]]) -> CameraView | None:
        held = self._system.camera
        if not isinstance(held, HeldCamera):
            return held
        if held.arm not in cycles:
            return None
        received, cycle = cycles[held.arm]
        q = np.array(cycle.q)
        if q.shape != (held.chain.dof,):
            return None
        return CameraView(held.view(q), received)

    def _move(
        self, hand: Hand, now: float, views: dict[str, ArmView], camera: CameraView | None
    ) -> None:
        sample = self._pedals.merge(hand.read(now), time.monotonic())
        pressed = hand.pressed(sample)
        if "record" in pressed:
            self._record.publish(Bool(not self._recording))
        if sample is not None and "enable" in pressed:
            self._switch(hand, hand.switch.enables(sample.buttons))
        for arm, output in hand.switch.tick(now, sample, views, camera).items():
            commands = output.commands
            if arm == ASSISTANT and self._system.assistant is not None:
                commands = self._system.assistant.convert(commands)
            self._ports[arm].send(commands)
            self._say(hand, arm, output)

    def _switch(self, hand: Hand, on: bool) -> None:
        """The operator takes or leaves the seat."""
        if on:
            self._pedals.forget(time.monotonic())
            hand.switch.enable()
        else:
            hand.switch.disable()

    # What people read.

    def _say(self, hand: Hand, arm: str, output: TeleopOutput) -> None:
        one = hand.switch.arms[arm]
        values: dict[str, object] = {
            "current_state": output.state.value,
            "desired_state": "DISABLED" if output.state is State.DISABLED else "FOLLOWING",
            "following": output.state is State.FOLLOWING,
            "scale": one.scale,
            "rotation_locked": one.lock_rotation,
            "translation_locked": one.lock_translation,
        }
        for name, value in values.items():
            if self._said.get((arm, name)) != value:
                self._said[arm, name] = value
                self._latched[arm, name].publish(value)
        message = self._message(hand, output)
        if message and self._said.get((arm, "message")) != message:
            text, now = f"{hand.leader.name} on {arm}: {message}", time.monotonic()
            if now - self._warned.get(text, -math.inf) >= AGAIN:
                self._warned[text] = now
                self._warn(text)
        self._said[arm, "message"] = message

    def _message(self, hand: Hand, output: TeleopOutput) -> str:
        """A device that cannot be opened is a better reason than its silence."""
        return hand.problem if hand.problem and output.message else output.message

    def _warn(self, text: str) -> None:
        rospy.logwarn("%s", text)
        self._warning.publish(text)

    def _tell(self, now: float) -> None:
        picture = self._picture.problem(time.monotonic()) if not self._system.lockstep else ""
        hands = [
            (
                hand.leader.name,
                arm,
                one.state.name,
                one.mode.name,
                one.scale,
                self._said.get((arm, "message"), ""),
            )
            for hand in self._system.hands
            for arm, one in hand.switch.arms.items()
        ]
        if picture and self._picture_problem == "":
            self._warn(picture)
        self._picture_problem = picture
        if (status := (picture, *hands)) != self._status or now - self._reported >= REPORT:
            self._status, self._reported = status, now
            message = TeleopStatus(
                version=TeleopStatus.VERSION,
                hands=[_hand_status(*each) for each in hands],
                picture=picture,
            )
            message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
            self._report.publish(message)

    # Lock-step connections.

    def connect(self) -> None:
        """Lock-step: waits for every connection, then answers tick 1, before which is no cycle.

        Raises:
            TimeoutError: Somebody is missing; says who.
            OSError: The master does not answer.
        """
        self._participant.connect(CONNECT_TIMEOUT)


def _hand_status(
    leader: str, arm: str, state: str, mapping: str, scale: float, detail: str
) -> HandStatus:
    return HandStatus(
        leader=leader,
        arm=arm,
        state=getattr(HandStatus, f"STATE_{state}"),
        mapping=getattr(HandStatus, f"MAPPING_{mapping}"),
        scale=scale,
        detail=detail,
    )


def _listen(topic: str, kind: type, callback: Any, arguments: Any = None) -> rospy.Subscriber:
    keys: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
    if arguments is None:
        return rospy.Subscriber(topic, kind, callback, **keys)
    return rospy.Subscriber(topic, kind, callback, arguments, **keys)


def main() -> int:
    """Runs the node.

    Returns:
        The exit code.
    """
    if not rosgraph.is_master_online():
        print(
            f"teleop: no ROS master at {rosgraph.get_master_uri()}; start one with './surg teleop' "
            "or './surg up CELL'",
            file=sys.stderr,
        )
        return 1
    rospy.init_node("teleop", disable_signals=True)
    try:
        system = read_setup(dict(rospy.get_param("~", {})), rospy.get_name())
    except (ParamError, ConfigError, LeaderError) as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 2
    node = TeleopNode(system)

    def end(*_: Any) -> None:
        node.finished.set()
        _end_within(END)

    # rospy's own handler would close the topics before the arms have been told to stop.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    try:
        if system.lockstep:
            node.connect()
            while not node.finished.wait(0.1) and not rospy.is_shutdown():
                pass
        else:
            node.run()
    except OSError as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 1
    finally:
        _end_within(END)
        node.stop()
        rospy.signal_shutdown("teleop: done")
    return 0


def _end_within(seconds: float) -> None:
    """No device, and no connection whose other end reads nothing more, keeps this process."""

    def give_up() -> None:
        print(
            f"teleop: something hangs {seconds:g} s after the end was asked for (a device, or a "
            "connection): ended without waiting for it; what was not told to stop, its controller "
            "stops by itself (F03)",
            file=sys.stderr,
            flush=True,
        )
        os._exit(1)

    timer = threading.Timer(seconds, give_up)
    timer.daemon = True
    timer.start()
