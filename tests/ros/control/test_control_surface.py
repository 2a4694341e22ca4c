"""The controller's surface: joint targets, frames, queries, a hostile environment, the way out.

What the core decides is its own tests' business; here it is whether it gets there.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from tf2_msgs.msg import TFMessage

from crtk_msgs.msg import StringStamped
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics
from helpers.graph.control_rig import ANSWER_S, CELL, Rig, real_time, start, tip_in_rcm
from helpers.graph.ros import RosGraph, find_executable
from surg_cli.graph import master
from surg_msgs.msg import Cycle, PointVelocityStamped

pytestmark = [pytest.mark.ros, pytest.mark.untimed]


class Voice:
    """Publishers and subscribers of one test, connected before they are used."""

    def __init__(self, graph: RosGraph, rig: Rig) -> None:
        self.graph, self.rig = graph, rig
        self.heard: dict[str, list[Any]] = {}

    def speak(self, topic: str, kind: type) -> Callable[[Any], None]:
        """A function that sends to /PSM1/topic and counts for lock-step."""
        publisher = rospy.Publisher(f"/PSM1/{topic}", kind, queue_size=0, tcp_nodelay=True)
        self.graph.wait_for(lambda: publisher.get_num_connections() > 0, ANSWER_S, topic)

        def send(message: Any) -> None:
            publisher.publish(message)
            self.rig.sent += 1

        return send

    def listen(self, topic: str, kind: type) -> list[Any]:
        """Everything that comes on a topic from now on."""
        heard: list[Any] = []
        full = topic if topic.startswith("/") else f"/PSM1/{topic}"
        subscriber = rospy.Subscriber(full, kind, heard.append, queue_size=None)
        self.graph.wait_for(lambda: subscriber.get_num_connections() > 0, ANSWER_S, topic)
        return heard


@pytest.fixture
def voice(ros_graph: RosGraph, rig: Rig) -> Voice:
    """Publishers and subscribers."""
    return Voice(ros_graph, rig)


def diagnosed(heard: list[DiagnosticArray]) -> dict[str, str]:
    """The last values on /diagnostics."""
    return {entry.key: entry.value for entry in heard[-1].status[0].values} if heard else {}


def pose_message(p: np.ndarray, frame: str = "") -> PoseStamped:
    """A pose without rotation."""
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y, message.pose.position.z = p
    message.pose.orientation.w = 1.0
    return message


def virtual_joints(cycle: Cycle) -> np.ndarray:
    """Measured yaw, pitch, insertion, roll of a cycle, by the definition in the conventions."""
    p = tip_in_rcm(cycle)
    depth = np.linalg.norm(p)
    return np.array([math.atan2(p[0], p[2]), math.asin(p[1] / depth), depth, cycle.roll])


def test_joint_commands_arrive(ros_graph: RosGraph, rig: Rig, voice: Voice) -> None:
    """One after the other, there and back."""
    start(ros_graph, rig)
    topics = ("move_jp", "move_jr", "interpolate_jp", "servo_jr")
    send = {topic: voice.speak(topic, JointState) for topic in topics}
    rig.enable()
    for _ in range(10):  # the edge of is_busy that belongs to home
        cycle = rig.step()
    change = np.array([0.05, -0.04, 0.01, 0.2])
    for topic in topics:
        begin = virtual_joints(cycle)
        if topic == "servo_jr":  # a stream of small changes
            for k in range(250):  # its end is at rest, or the tip would stop a little beyond
                part = change / 200 if k < 200 else 0 * change
                send[topic](JointState(position=part.tolist()))
                cycle = rig.step()
        else:
            there = change if topic == "move_jr" else begin + change
            send[topic](JointState(position=there.tolist()))
            cycle = rig.step()
            assert cycle.busy == topic.startswith("move")
        for _ in range(700):
            cycle = rig.step()
        assert cycle.refused == 0, rig.texts
        assert not cycle.busy
        assert np.allclose(virtual_joints(cycle) - begin, change, atol=1e-3), topic
        change = -change


def test_base_frame_is_spoken_in_both_directions(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    start(ros_graph, rig)
    set_frame = voice.speak("set_base_frame", PoseStamped)
    measured = voice.listen("measured_cp", PoseStamped)
    local = voice.listen("local/measured_cp", PoseStamped)
    shift = np.array([0.1, 0.2, 0.3])
    set_frame(pose_message(shift, "table"))
    tip = tip_in_rcm(rig.enable())
    set_frame(pose_message(2 * shift, "other"))  # ENABLED: refused
    rig.pose(tip, frame="PSM1_rcm")  # no longer the expected one
    rig.pose(tip + shift, frame="table")
    cycle = rig.step()
    assert (cycle.refused, cycle.accepted) == (1, 1)
    rig.wait_text("warning", "set_base_frame from")
    text = rig.wait_text("warning", "frame_id is 'PSM1_rcm'")
    assert "servo_cp" in text and "allowed is 'table'" in text
    while rig.tick < 15:
        rig.step()
    ros_graph.wait_for(lambda: len(measured) >= 3 and len(local) >= 3, ANSWER_S, "feedback")
    p, q = measured[-1].pose.position, local[-1].pose.position
    assert (measured[-1].header.frame_id, local[-1].header.frame_id) == ("table", "PSM1_rcm")
    assert np.allclose([p.x, p.y, p.z], tip + shift, atol=1e-6)
    assert np.allclose([q.x, q.y, q.z], tip, atol=1e-6)
    answer = rospy.ServiceProxy("/PSM1/forward_kinematics", QueryForwardKinematics)(
        jp=virtual_joints(cycle)
    )
    assert np.allclose([getattr(answer.cp.position, axis) for axis in "xyz"], [p.x, p.y, p.z])


def test_kinematics_queries(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    joints = [0.1, -0.2, 0.12, 0.4]
    forward = rospy.ServiceProxy("/PSM1/local/forward_kinematics", QueryForwardKinematics)
    inverse = rospy.ServiceProxy("/PSM1/inverse_kinematics", QueryInverseKinematics)
    pose = forward(jp=joints)
    assert pose.result, pose.message
    anywhere = rospy.ServiceProxy("/PSM1/forward_kinematics", QueryForwardKinematics)
    assert anywhere(jp=joints).cp == pose.cp  # the base frame is the rcm frame
    back = inverse(cp=pose.cp, jp=[])
    assert back.result, back.message
    assert np.allclose(back.jp, joints, atol=1e-12)
    assert not forward(jp=[0.0]).result
    pose.cp.position.z = 1.0
    refused = inverse(cp=pose.cp, jp=[])
    assert not refused.result and "allowed" in refused.message


def test_words_are_said_once_for_what_cannot_be_followed(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    start(ros_graph, rig)
    twist = voice.speak("servo_cv", TwistStamped)
    rig.enable()
    for _ in range(20):
        message = TwistStamped()
        message.twist.angular.x = 0.5
        twist(message)
        rig.step()
    rig.wait_text("warning", "only the part along the shaft")
    assert sum("angular" in text for text in rig.texts["warning"]) == 1


def test_start_stop_words_and_claim(ros_graph: RosGraph, rig: Rig, voice: Voice) -> None:
    start(ros_graph, rig)
    insert = voice.speak("rcm/insert", StringStamped)
    claim = voice.speak("authority/claim", Empty)
    rig.enable()
    insert(StringStamped(string="begin"))
    claim(Empty())
    assert rig.step().source == f"/{rig.name}"
    assert "allowed are start, stop" in rig.wait_text("warning", "rcm/insert")
    rig.wait_text("status", "authority/claim")
    for _ in range(400):  # at rest for 0.8 s: an ordinary holder would have lost it
        cycle = rig.step()
    assert cycle.source == f"/{rig.name}"


def test_track_exists_only_where_it_is_configured(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    start(ros_graph, rig, track_rcm=True)
    track = voice.speak("rcm/track", PointVelocityStamped)
    message = PointVelocityStamped()
    message.header.frame_id = "PSM1_rcm"
    track(message)
    rig.step()
    assert "allowed is 'PSM1_base'" in rig.wait_text("warning", "rcm/track")


def test_a_row_of_refused_commands_says_when_it_began(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    """A stream to an arm that is not enabled: one warning a second, with number and beginning."""
    start(ros_graph, rig)
    stream = voice.speak("servo_jp", JointState)
    for _ in range(1750):  # 3.5 s
        stream(JointState(position=[0.0, 0.0, 0.1, 0.0]))
        rig.step()
    last = rig.wait_text("warning", "it began 3 s ago")
    assert "(and 499 times more since the last one" in last and "send 'enable'" in last
    said = [text for text in rig.texts["warning"] if "refused" in text]
    assert len(said) == 4 and "times more" not in said[0]
    for _ in range(1500):  # silence ends the row
        rig.step()
    stream(JointState(position=[0.0, 0.0, 0.1, 0.0]))
    rig.step()
    rig.wait_text("warning", "(and 249 times more since the last one)")


def test_the_urdf_hangs_on_our_frames(ros_graph: RosGraph, rig: Rig, voice: Voice) -> None:
    start(ros_graph, rig)
    got = voice.listen("/tf_static", TFMessage)
    ros_graph.wait_for(lambda: len(got) > 0, ANSWER_S, "/tf_static")
    frames = {(t.header.frame_id, t.child_frame_id) for t in got[0].transforms}
    assert frames == {("world", "PSM1_base"), ("PSM1_base", "base_link")}
    topics = [name for name, _ in rospy.get_published_topics()]
    assert "/PSM1/rcm/track" not in topics


def test_f16_a_changed_parameter_is_named_and_has_no_effect(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    start(ros_graph, rig)
    master.call(ros_graph.uri, "setParam", "/PSM1/controller/law", "paper")
    text = rig.wait_text("warning", "~law")
    assert "is 'paper' now and was not set" in text
    limits_hash = text.partition("limits_hash stays ")[2].partition(")")[0]
    heard = voice.listen("/diagnostics", DiagnosticArray)
    for _ in range(500):
        rig.step()
    ros_graph.wait_for(lambda: len(heard) > 0, ANSWER_S, "diagnostics")
    values = diagnosed(heard)
    assert values["limits_hash"] == limits_hash != ""
    assert (values["law"], values["changed_params"]) == ("exact", "1")


class Relay:
    """A way to the master that can be cut or frozen, as seen by one node."""

    def __init__(self, uri: str) -> None:
        host, _, port = uri.removeprefix("http://").rstrip("/").partition(":")
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.uri = f"http://localhost:{self._listener.getsockname()[1]}/"
        self.frozen = False
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if self.frozen:
                self._held = near  # accepted, never answered
                continue
            far = socket.create_connection(self._target)
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(a, b), daemon=True).start()

    @staticmethod
    def _pump(source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def cut(self) -> None:
        """From now on connections are refused, as by a master that has died."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


@pytest.mark.timed
@pytest.mark.parametrize("how", ["dead", "frozen"])
def test_f07_a_lost_master_is_noticed_and_the_loop_goes_on(
    ros_graph: RosGraph, rig: Rig, how: str
) -> None:
    relay = Relay(ros_graph.uri)
    start(ros_graph, rig, env={"ROS_MASTER_URI": relay.uri})
    tip = tip_in_rcm(rig.enable())
    begin = time.monotonic()
    if how == "dead":
        relay.cut()
    else:
        relay.frozen = True
    rig.wait_text("error", "master_lost")
    noticed = time.monotonic() - begin
    print(f"noticed after {noticed:.2f} s of wall clock")
    assert noticed < 2.5  # 2 s, and the machine is shared
    rig.pose(tip + np.array([0.001, 0, 0]))
    cycle = rig.step()
    assert (cycle.refused, cycle.state) == (0, Cycle.ENABLED)
    rig.say("pause")
    assert rig.step().state == Cycle.PAUSED
    rig.say("resume")  # a run in lock-step is the same however busy the master is
    cycle = rig.step()
    assert (cycle.refused, cycle.state) == (0, Cycle.ENABLED)
    if how == "frozen":
        relay.frozen = False
        rig.wait_text("status", "answers again")
        relay.cut()


@pytest.mark.timed
def test_f07_a_lost_master_refuses_enable_in_real_time(ros_graph: RosGraph, rig: Rig) -> None:
    relay = Relay(ros_graph.uri)
    env = {"ROS_MASTER_URI": relay.uri}
    start(ros_graph, rig, env=env, mode="freerun", participants=[])
    with real_time(rig):
        enable(ros_graph, rig)
        relay.frozen = True
        rig.wait_text("error", "master_lost")
        rig.say("pause")
        ros_graph.wait_for(lambda: rig.states[-1].state == "PAUSED", ANSWER_S, "PAUSED")
        rig.say("resume")
        rig.wait_text("warning", "master is gone")
        assert rig.states[-1].state == "PAUSED"
        relay.frozen = False
        rig.wait_text("status", "answers again")
        rig.say("resume")
        ros_graph.wait_for(lambda: rig.states[-1].state == "ENABLED", ANSWER_S, "ENABLED")
        relay.cut()


@pytest.mark.timed
def test_f09_stamps_of_the_future_are_counted_and_decide_nothing(
    ros_graph: RosGraph, rig: Rig, voice: Voice
) -> None:
    start(ros_graph, rig, mode="freerun", participants=[])
    heard = voice.listen("/diagnostics", DiagnosticArray)
    with real_time(rig, ahead_s=3600.0):
        rig.wait_text("warning", "in the future")
        enable(ros_graph, rig)
        ros_graph.wait_for(
            lambda: int(diagnosed(heard).get("future_stamps", "0")) > 100, ANSWER_S, "the count"
        )


@pytest.mark.timed
def test_f09_a_halted_sim_clock_does_not_stop_the_watchdog(ros_graph: RosGraph, rig: Rig) -> None:
    master.call(ros_graph.uri, "setParam", "/use_sim_time", True)
    start(ros_graph, rig, mode="freerun", participants=[])
    with real_time(rig) as sent:
        stream(ros_graph, rig, sent, 0.4)
        rig.wait_text("warning", "fell silent")
        ros_graph.wait_for(lambda: not np.any(np.abs(sent[-1]) > 1e-3), ANSWER_S, "standstill")


def enable(graph: RosGraph, rig: Rig) -> None:
    """Home and enable, again where a starved plant was silent for longer than link_timeout."""

    def enabled() -> bool:
        if rig.states[-1].state == "ENABLED":
            return True
        rig.say("home")
        rig.say("enable")
        time.sleep(0.2)
        return False

    graph.wait_for(enabled, 2 * ANSWER_S, "ENABLED")


def stream(
    graph: RosGraph, rig: Rig, sent: list[np.ndarray], seconds: float, check: bool = True
) -> None:
    """Home, enable, and stream a sideways motion of 40 mm/s, then fall silent."""
    rig.cycles.get(timeout=ANSWER_S)
    enable(graph, rig)
    while not rig.cycles.empty():
        tip = tip_in_rcm(rig.cycles.get())
    begin = time.monotonic()
    while (passed := time.monotonic() - begin) < seconds:
        rig.pose(tip + np.array([0.04 * min(passed, 1.0), 0.0, 0.0]))
        time.sleep(0.005)
    assert not check or np.abs(sent[-1]).max() > 0.01, "the arm does not move"


@pytest.mark.timed
@pytest.mark.parametrize(
    ("nodelet", "how"),
    [(False, signal.SIGTERM), (True, signal.SIGTERM), (True, signal.SIGINT), (True, None)],
)
def test_f28_an_ending_controller_ramps_through_the_law_and_exits_with_0(
    ros_graph: RosGraph, rig: Rig, nodelet: bool, how: signal.Signals | None
) -> None:
    if nodelet:
        params = {"cell": CELL, "mode": "freerun"}
        ros_graph.set_params("/PSM1/controller", params)
        child = ros_graph.supervisor.start(
            "/PSM1/controller",
            ["/usr/lib/nodelet/nodelet", "standalone", "surg_control/RcmNodelet",
             "__name:=controller", "__ns:=/PSM1"],
        )  # fmt: skip
        ros_graph.wait_for(lambda: rig.connected(False), 20.0, "the nodelet's connections")
    else:
        child = start(ros_graph, rig, mode="freerun", participants=[])
    with real_time(rig) as sent:
        sender = threading.Thread(target=stream, args=(ros_graph, rig, sent, 2.0, False))
        sender.start()  # it goes on sending, and must not be obeyed any more
        ros_graph.wait_for(
            lambda: bool(sent) and np.abs(sent[-1]).max() > 0.2, 2 * ANSWER_S, "motion"
        )
        if how is None:
            api = master.call(ros_graph.uri, "lookupNode", "/PSM1/controller")
            master.call(api, "shutdown", "a test ends it")
        else:
            child.process.send_signal(how)
        begin = time.monotonic()
        assert child.process.wait(10) == 0
        print(f"ended after {time.monotonic() - begin:.2f} s of wall clock")
        sender.join()
    assert not np.any(sent[-1])
    # The link may miss a command in real time; the cycle messages are queued.
    cycles = list(rig.cycles.queue)
    ending = next(k for k, cycle in enumerate(cycles) if cycle.state != Cycle.ENABLED)
    commands = np.array([cycle.qd_command for cycle in cycles[ending - 1 :]])
    moving = int(np.sum(np.abs(commands).max(axis=1) > 1e-6))
    print(f"standstill after {moving} cycles")
    assert not np.any(commands[-1])
    assert moving >= 5, "a cut and no ramp"
    # A cut would be a step of five times the limit; the exact bound is the core's business.
    steps = np.abs(np.diff(commands, axis=0)).max(axis=0)
    assert np.all(steps <= np.array(rig.arm.robot.acceleration) * 0.002 * 1.5), steps
    # The plant is integrated by the clock of a shared machine.
    assert max(cycle.rcm_error for cycle in cycles) < 5e-4


def test_a_fault_leaves_a_black_box_that_runs_again(
    ros_graph: RosGraph, rig: Rig, tmp_path: Path
) -> None:
    start(ros_graph, rig, black_box=tmp_path / "boxes")
    tip = tip_in_rcm(rig.enable())
    for k in range(100):
        rig.pose(tip + np.array([2e-5 * k, 0.0, 0.0]))
        rig.step()
    rig.pose(np.array([math.nan, 0.0, 0.1]))
    assert rig.step().state == Cycle.FAULT
    for _ in range(160):
        rig.step()
    text = rig.wait_text("status", "black box")
    (file,) = (tmp_path / "boxes").glob("PSM1_*.blackbox")
    assert str(file) in text
    replay = subprocess.run(
        [find_executable("surg_control", "rcm_replay"), "--black-box", file],
        capture_output=True, text=True, env=os.environ, timeout=60, check=False,
    )  # fmt: skip
    assert replay.returncode == 0, replay.stdout + replay.stderr
    assert "FAULT(not_finite)" in replay.stdout
    assert "bit for bit the same" in replay.stdout
