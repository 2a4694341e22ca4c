"""Teleoperation as a node: the leaders of one cell (docs/reference/teleoperation.md).

Parameters: ``~cell`` (folder or cell.yaml); ``~leader`` (a bundled leader, an entry point, a
``.py`` file, or ``crtk`` for topics), ``~settings`` (of the leader, a mapping), ``~arm`` (PSM1),
``~mapping`` (position | rate), ``~scale`` (0.2), ``~need_present`` (false); the same with the
prefix ``second_`` for a second leader, whose arm may be ``assistant``, with ``~assistant_frame``
(x, y, z, w of its trocar frame in the world); ``~view`` (x, y, z, w of the view in the world, for a
fixed endoscope); ``~picture`` (/endoscope/left/image_raw; empty: not supervised). Exit code 1: a
connection is missing, or the shutdown hung; 2: invalid file or parameter.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
import threading
import time
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import rospy
from genpy import DeserializationError
from sensor_msgs.msg import JointState

from surg_core import ConfigError
from surg_core.arm_view import ArmView
from surg_core.contract import SECOND_NS
from surg_core.hand.message_lateness import Arrivals
from surg_core.held_endoscope import HeldEndoscope
from surg_core.status_check import fault
from surg_msgs.msg import Cycle, DriftStatus
from surg_ros.arm_port import KINDS, SERVO_INSTRUMENT, ArmPort, arm_view
from surg_ros.byte_topics import BytesSubscriber
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError
from surg_teleop.follow.arm_switch import Hand
from surg_teleop.follow.force_feedback_node import ForceFeedbackTopics
from surg_teleop.follow.operator_topics_node import OperatorTopics, listen
from surg_teleop.follow.picture_watch import PictureWatch
from surg_teleop.follow.servo_instrument import ServoInstrument
from surg_teleop.follow.teleop_setup import ASSISTANT, TeleopSetup, read_setup
from surg_teleop.follow.teleop_status_node import TeleopStatusPublisher
from surg_teleop.follow.teleop_types import CameraView
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.crtk_leader_node import CrtkTopics
from surg_teleop.leaders.leader import LeaderError

POLLED_PERIOD = 0.004
"""[s] Period of leaders that are polled."""
TOPIC_PERIOD = 0.010
"""[s] Longest period of leaders on topics; their messages start a tick at once."""
END = 2.0
"""[s] Longest shutdown, whatever hangs."""
FLUSH = 0.2
"""[s] Wait after the last commands, so that they leave their queues and sockets."""


class TeleopNode:
    """Connects leaders, arms and the camera; :class:`Teleop` makes every decision."""

    def __init__(self, setup: TeleopSetup) -> None:
        self._setup = setup
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self.finished = threading.Event()
        """Set to end the node."""
        self._cycles: dict[str, tuple[float, Cycle]] = {}
        self._arrivals = {arm: Arrivals() for arm in setup.heard}
        self._picture = PictureWatch(setup.picture)
        self._moved = ""
        self._ports = {name: ArmPort(name, tuple(KINDS)) for name in setup.bases}
        if setup.assistant is not None:
            self._ports[ASSISTANT] = ArmPort(ASSISTANT, SERVO_INSTRUMENT)
        self._status = TeleopStatusPublisher(setup.hands)
        # Ticks are less frequent than cycles, so each reads the newest cycle only.
        self._polled = {arm: BytesSubscriber(f"/{arm}/cycle", Cycle) for arm in setup.heard}
        for hand in setup.hands:
            if isinstance(hand.leader, CrtkLeader):
                CrtkTopics(hand.leader, self._lock, self._wake)
        self._operator = OperatorTopics(setup.hands, self._status, self._lock, self._wake)
        self._felt = ForceFeedbackTopics(setup.hands, self._lock) if setup.haptics else None
        if setup.assistant is not None:
            listen(f"/{ASSISTANT}/measured_js", JointState, self._on_joints, setup.assistant)
            listen(f"/{ASSISTANT}/jaw/measured_js", JointState, self._on_jaw, setup.assistant)
        if setup.picture:
            listen(setup.picture, rospy.AnyMsg, self._on_picture)
        listen("/endoscope/drift", DriftStatus, self._on_drift)

    def _on_joints(self, message: JointState, assistant: ServoInstrument) -> None:
        with self._lock:
            stamp = message.header.stamp.to_nsec()
            assistant.joints(time.monotonic(), stamp, np.array(message.position))

    def _on_jaw(self, message: JointState, assistant: ServoInstrument) -> None:
        if message.position:
            with self._lock:
                assistant.jaw(message.position[0])

    def _on_picture(self, message: rospy.AnyMsg) -> None:
        # Header: sequence, seconds, nanoseconds, frame_id; the pixels need not be unpacked.
        data = memoryview(message._buff)
        seconds, nanoseconds, frame = struct.unpack_from("<3I", data, 4)
        stamp = seconds * SECOND_NS + nanoseconds
        with self._lock:
            self._picture.picture(time.monotonic(), stamp, zlib.crc32(data[16 + frame :]))

    def _on_drift(self, message: DriftStatus) -> None:
        if message.refusal and not fault(message):  # for good: it needs another calibration
            with self._lock:
                self._moved = message.refusal

    def run(self) -> None:
        """Tick on every leader message and every period, until ``finished``."""
        on_topics = all(isinstance(hand.leader, CrtkLeader) for hand in self._setup.hands)
        period = TOPIC_PERIOD if on_topics else POLLED_PERIOD
        while not self.finished.is_set() and not rospy.is_shutdown():
            self._wake.wait(period)
            self._wake.clear()
            with self._lock:
                self._act(time.monotonic())

    def stop(self) -> None:
        """Disable all arms and close the leaders; no exit leaves an arm moving."""
        with self._lock:
            for hand in self._setup.hands:
                hand.switch.disable()
            self._act(time.monotonic())
            for hand in self._setup.hands:
                hand.leader.close()

    def _act(self, now: float) -> None:
        setup = self._setup
        self._fetch_cycles()
        views = {
            name: arm_view(cycle, setup.bases[name], received)
            for name, (received, cycle) in self._cycles.items()
            if name in setup.bases
        }
        if setup.assistant is not None and (view := setup.assistant.view()) is not None:
            views[ASSISTANT] = view
        camera = self._camera()
        if camera is not None and self._moved:
            camera = replace(camera, moved=self._moved)
        for hand in setup.hands:
            self._move(hand, now, views, camera)
        self._status.status(now, self._picture.problem(time.monotonic()))

    def _fetch_cycles(self) -> None:
        """Keep the newest cycle of every arm; one that the network delayed is older."""
        for arm, polled in self._polled.items():
            if messages := polled.fetch():
                try:
                    cycle = Cycle().deserialize(messages[-1])
                    received = self._arrivals[arm].of(cycle.header.stamp.to_sec(), time.monotonic())
                    self._cycles[arm] = (received, cycle)
                except DeserializationError as error:
                    rospy.logwarn_throttle(1.0, f"/{arm}/cycle: unreadable message: {error}")

    def _camera(self) -> CameraView | None:
        held = self._setup.camera
        if not isinstance(held, HeldEndoscope):
            return held
        if held.arm not in self._cycles:
            return None
        received, cycle = self._cycles[held.arm]
        q = np.array(cycle.q)
        return CameraView(held.rotation(q), received) if q.shape == (held.chain.dof,) else None

    def _move(
        self, hand: Hand, now: float, views: dict[str, ArmView], camera: CameraView | None
    ) -> None:
        sample = self._operator.pedals.merge(hand.read(now), time.monotonic())
        pressed = hand.pressed(sample)
        if "record" in pressed:
            self._operator.toggle_recording()
        if sample is not None and "enable" in pressed:
            self._operator.switch(hand, hand.switch.enables(sample.buttons))
        for arm, output in hand.switch.tick(now, sample, views, camera).items():
            commands = output.commands
            if arm == ASSISTANT and self._setup.assistant is not None:
                commands = self._setup.assistant.convert(commands)
            self._ports[arm].send(commands)
            self._status.state(hand, arm, output)
            if self._felt is not None:
                self._felt.follow(arm, output, views.get(arm), camera)
        self._operator.publish()


def main() -> int:
    """Run the node; returns the exit code."""
    if not master_is_online("teleop"):
        return 1
    rospy.init_node("teleop", disable_signals=True)
    try:
        setup = read_setup(dict(rospy.get_param("~", {})), rospy.get_name())
    except (ParamError, ConfigError, LeaderError) as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 2
    node = TeleopNode(setup)

    def end(*_: Any) -> None:
        node.finished.set()
        _end_within(END)

    # rospy's own handler would close the topics before the arms are stopped.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    try:
        node.run()
    except OSError as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 1
    finally:
        _end_within(END)
        node.stop()
        time.sleep(FLUSH)
        rospy.signal_shutdown("teleop: done")
    return 0


def _end_within(seconds: float) -> None:
    """End the process even if a device or a connection hangs."""

    def give_up() -> None:
        print(
            f"teleop: a device or connection hangs {seconds:g} s after the shutdown began; the "
            "process ends without it. Each controller stops its arm by itself (F03)",
            file=sys.stderr,
            flush=True,
        )
        os._exit(1)

    timer = threading.Timer(seconds, give_up)
    timer.daemon = True
    timer.start()
