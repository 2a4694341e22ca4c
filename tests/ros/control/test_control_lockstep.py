"""The controller node in lock-step: the fake robot and operator are this process."""

from __future__ import annotations

import contextlib
import math
import queue
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

import surg_core
from crtk_msgs.msg import OperatingState
from helpers.control import urdf_variants
from helpers.graph import socket_jitter
from helpers.graph.control_rig import (
    ANSWER_S,
    CELL,
    SILENCE_S,
    TICK_NS,
    Rig,
    follow,
    stamp,
    start,
    tip_in_rcm,
)
from helpers.graph.ros import RosGraph
from surg_cli.graph import master
from surg_msgs.msg import Cycle, LinkStatus

pytestmark = [pytest.mark.ros, pytest.mark.untimed]


def test_every_tick_is_answered_and_the_arm_follows(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    cycles = follow(rig, 500)
    tips = np.array([tip_in_rcm(cycle) for cycle in cycles])
    assert np.ptp(tips[:, 0]) == pytest.approx(0.004, abs=2e-4)
    assert np.ptp(tips[:, 1:], axis=0).max() < 1e-5
    assert max(cycle.rcm_error for cycle in cycles) < 1e-5
    assert {cycle.source for cycle in cycles} == {f"/{rig.name}"}
    assert cycles[-1].refused == 0
    assert cycles[-1].accepted >= 500
    # The tip from the node is the tip of the chain that the Python side has.
    X_BF = rig.arm.chain.forward(np.array(cycles[-1].q))
    p_tip = X_BF[:3, :3] @ np.array(rig.arm.tool.p_FTip) + X_BF[:3, 3]
    assert np.allclose(p_tip, cycles[-1].p_tip, atol=1e-12)


def test_same_commands_give_the_same_answers(ros_graph: RosGraph, rospy_node: str) -> None:
    runs = []
    for jitter in (0.0, 3.0):
        rig = Rig(rospy_node)
        child = start(ros_graph, rig, env=socket_jitter.environment(jitter))
        runs.append([tuple(cycle.qd_command) for cycle in follow(rig, 60)])
        child.process.send_signal(signal.SIGTERM)
        assert child.process.wait(10) == 0
        rig.close()
    assert runs[0] == runs[1]
    assert any(any(abs(v) > 1e-4 for v in answer) for answer in runs[0])


def test_repeated_state_gets_the_same_answer_again(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    rig.enable()
    rig.step()
    q_after, qd_after = rig.q, rig.qd
    rig.q = q_after + 0.01  # whatever the repetition says: tick k has been answered
    rig.publish_state(rig.tick)
    again = rig.answers.get(timeout=ANSWER_S)
    assert again.header.stamp == stamp(rig.tick)
    assert list(again.velocity) == qd_after.tolist()
    assert rig.tools.get(timeout=ANSWER_S).header.stamp == stamp(rig.tick)
    rig.q = q_after
    with pytest.raises(queue.Empty):
        rig.cycles.get(timeout=SILENCE_S)
    assert rig.step().tick == rig.tick


def test_waits_until_all_announced_messages_are_there(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    rig.enable()
    tick = rig.tick + 1
    rig.publish_state(tick)
    with pytest.raises(queue.Empty):  # not ready
        rig.answers.get(timeout=SILENCE_S)
    rig.publish_ready(tick, rig.sent + 2)
    with pytest.raises(queue.Empty):  # two messages announced, none here
        rig.answers.get(timeout=SILENCE_S)
    rig.publish_state(tick)  # the bridge asks again: the controller says whom it waits for
    assert f"{rig.name} has sent" in rig.wait_text("status", "waits")
    rig.say("pause")
    with pytest.raises(queue.Empty):
        rig.answers.get(timeout=SILENCE_S)
    rig.pose(np.array([0.0, 0.0, 0.12]), frame="world")  # refused, and yet counted
    assert rig.answers.get(timeout=ANSWER_S).header.stamp == stamp(tick)
    cycle = rig.cycles.get(timeout=ANSWER_S)
    assert cycle.state == Cycle.PAUSED
    assert cycle.refused == 1


def test_what_is_refused_is_said_with_the_cure(ros_graph: RosGraph, rig: Rig) -> None:
    """A motion before enable; then a frame and a size that are none."""
    start(ros_graph, rig)
    rig.step()
    rig.pose(np.array([0.0, 0.0, 0.12]))
    cycle = rig.step()
    assert cycle.refused == 1
    assert not np.any(cycle.qd_command)
    rig.wait_text("warning", "state_command first")
    p = tip_in_rcm(rig.enable())
    rig.pose(p, frame="PSM1_base")
    cycle = rig.step()
    assert cycle.refused == 2
    assert cycle.state == Cycle.ENABLED
    text = rig.wait_text("warning", "PSM1_base")
    assert "PSM1_rcm" in text and "servo_cp" in text
    rig.pose(p, frame="")
    assert rig.step().refused == 2
    rig.servo_jp.publish(JointState(position=[0.0, 0.0, 0.1]))
    rig.sent += 1
    assert rig.step().refused == 3
    assert "yaw, pitch, insertion, roll" in rig.wait_text("warning", "servo_jp")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_f01_not_finite_is_a_fault_and_output_stays_finite(
    ros_graph: RosGraph, rig: Rig, bad: float
) -> None:
    start(ros_graph, rig)
    p = tip_in_rcm(rig.enable())
    rig.pose(np.array([bad, p[1], p[2]]))
    cycle = rig.step()  # asserts finite output
    assert cycle.state == Cycle.FAULT
    assert cycle.reason == "not_finite"
    assert "FAULT" in rig.wait_text("error", "not_finite")
    for _ in range(20):
        rig.pose(p)
        assert rig.step().state == Cycle.FAULT


def test_undeclared_sender_is_obeyed_and_reported(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig, participants=[])
    rig.step()
    rig.say("home")
    deadline = time.monotonic() + ANSWER_S
    while not rig.step().homed:
        assert time.monotonic() < deadline
    assert rig.wait_text("undeclared", rig.name) == f"/{rig.name}"
    rig.wait_text("status", "undeclared")


def test_state_is_published_and_latched(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    rig.enable()
    ros_graph.wait_for(lambda: rig.states[-1].state == "ENABLED", ANSWER_S, "ENABLED")
    assert rig.states[0].state == "DISABLED"
    late = rospy.wait_for_message("/PSM1/operating_state", OperatingState, timeout=ANSWER_S)
    assert (late.state, late.is_homed) == ("ENABLED", True)
    cycle = rospy.wait_for_message("/PSM1/cycle", Cycle, timeout=ANSWER_S)
    assert cycle.tick == rig.tick  # a participant that connects late still gets its cycle


def test_feedback_carries_the_stamp_of_its_state(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    got: list[PoseStamped] = []
    subscriber = rospy.Subscriber("/PSM1/measured_cp", PoseStamped, got.append, tcp_nodelay=True)
    ros_graph.wait_for(lambda: subscriber.get_num_connections() > 0, ANSWER_S, "measured_cp")
    tip = tip_in_rcm(rig.enable())
    while rig.tick < 20:
        rig.step()
    ros_graph.wait_for(lambda: len(got) >= 4, ANSWER_S, "feedback")
    assert [m.header.stamp for m in got[:4]] == [stamp(k) for k in (5, 10, 15, 20)]
    assert got[0].header.frame_id == "PSM1_rcm"
    p = got[0].pose.position
    assert np.allclose([p.x, p.y, p.z], tip, atol=1e-9)
    subscriber.unregister()


def test_tf_says_what_measured_cp_says(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    got: list[TFMessage] = []
    subscriber = rospy.Subscriber("/tf", TFMessage, got.append, tcp_nodelay=True)
    ros_graph.wait_for(lambda: subscriber.get_num_connections() > 0, ANSWER_S, "/tf")
    follow(rig, 100)
    ros_graph.wait_for(lambda: len(got) >= 10, ANSWER_S, "tf")
    subscriber.unregister()
    frames = {(t.header.frame_id, t.child_frame_id) for t in got[-1].transforms}
    assert frames == {
        ("PSM1_base", "PSM1_flange"),
        ("PSM1_flange", "PSM1_tool"),
        ("PSM1_base", "PSM1_rcm"),
    }
    # The tool is bolted to the flange: a turning tool frame would be a wrong roll convention.
    tools = [
        [r.x, r.y, r.z, r.w]
        for message in got
        for r in (t.transform.rotation for t in message.transforms if "tool" in t.child_frame_id)
    ]
    spread = [1.0 - abs(float(np.dot(tools[1], tool))) for tool in tools[1:]]
    assert max(spread) < 1e-9


def test_a_link_lag_other_than_the_stated_one_is_a_warning(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    begin = tip_in_rcm(rig.enable())
    for k in range(500):  # this rig follows at once; the robot's YAML says 12 ms
        rig.pose(begin + np.array([0.01 * (1.0 - math.cos(2 * math.pi * k / 500)), 0.0, 0.0]))
        rig.step()
    assert rig.arm.robot.tuning.link_lag == 0.012
    assert "lags 0.0 ms" in rig.wait_text("status", "link_lag is 12.0 ms")
    rig.wait_text("warning", "lags 0.0 ms behind its commands; link_lag is 12.0 ms")


def test_twist_link_gets_the_flange_twist(ros_graph: RosGraph, rospy_node: str) -> None:
    rig = Rig(rospy_node, twist=True)
    start(ros_graph, rig, link="twist")
    words = ["", "home", "enable"]
    p = np.zeros(3)
    lag = rig.arm.robot.tuning.link_lag
    keep = np.exp(-TICK_NS * 1e-9 / lag)
    in_flight = np.zeros(6)  # the law acts where its command will find the arm
    for k in range(1, 40):
        if k <= 3:
            if words[k - 1]:
                rig.say(words[k - 1])
        else:
            rig.pose(p + np.array([2e-5 * (k - 3), 0.0, 0.0]))
        rig.publish_state(k)
        rig.publish_ready(k)
        answer = rig.answers.get(timeout=ANSWER_S)
        cycle = rig.cycles.get(timeout=ANSWER_S)
        if k <= 3:
            p = tip_in_rcm(cycle)
        v, w = answer.twist.linear, answer.twist.angular
        assert answer.header.stamp == stamp(k)
        assert answer.header.frame_id == "PSM1_base"
        assert [v.x, v.y, v.z, w.x, w.y, w.z] == list(cycle.twist_command)
        J = rig.arm.chain.jacobian(np.array(cycle.q) + in_flight)
        assert np.allclose(J @ np.array(cycle.qd_command), cycle.twist_command, atol=1e-9)
        in_flight = keep * in_flight + lag * (1 - keep) * np.array(cycle.qd_command)
        rig.q = rig.q + np.array(cycle.qd_command) * TICK_NS * 1e-9
    assert np.linalg.norm(cycle.twist_command) > 1e-4
    rig.close()


def test_link_in_another_mode_is_named(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    rig.link.publish(LinkStatus(command="joint_velocity", lockstep=False))
    rig.wait_text("error", "~mode")


def test_sigterm_commands_zero_and_exits_cleanly(ros_graph: RosGraph, rig: Rig) -> None:
    child = start(ros_graph, rig)
    follow(rig, 30)
    assert np.abs(rig.qd).max() > 0
    child.process.send_signal(signal.SIGTERM)
    assert not np.any(rig.answers.get(timeout=ANSWER_S).velocity)
    assert child.process.wait(10) == 0


@pytest.mark.timed
def test_free_run_keeps_500_hz(ros_graph: RosGraph, rig: Rig) -> None:
    rig.says["lockstep"] = False
    start(ros_graph, rig, mode="freerun", participants=[])
    stop = threading.Event()

    def link() -> None:
        tick = 0
        while not stop.wait(0.002):
            tick += 1
            rig.publish_state(tick)

    thread = threading.Thread(target=link)
    thread.start()
    with contextlib.ExitStack() as stack:
        stack.callback(thread.join)
        stack.callback(stop.set)
        rig.cycles.get(timeout=ANSWER_S)
        while not rig.cycles.empty():
            rig.cycles.get()
        begin = time.monotonic()
        first = rig.cycles.get(timeout=ANSWER_S)
        time.sleep(1.5)
        last = first
        while not rig.cycles.empty():
            last = rig.cycles.get()
        rate = (last.tick - first.tick) / (time.monotonic() - begin)
        print(f"free-run: {rate:.1f} Hz, {last.overruns} overruns")
        assert 400 < rate < 550  # the machine is shared; the soak run judges the rate
        rig.say("home")
        rig.say("enable")
        ros_graph.wait_for(lambda: rig.states[-1].state == "ENABLED", ANSWER_S, "ENABLED")
    # F10: the link is silent now.
    ros_graph.wait_for(lambda: rig.states[-1].state == "FAULT", ANSWER_S, "FAULT(link)")
    assert "FAULT(link)" in rig.wait_text("error", "link")


def test_nodelet_answers_too(ros_graph: RosGraph, rig: Rig) -> None:
    ros_graph.set_params("/PSM1/controller", {"cell": CELL, "participants": [rig.name]})
    ros_graph.supervisor.start(
        "/PSM1/controller",
        ["/usr/lib/nodelet/nodelet", "standalone", "surg_control/RcmNodelet",
         "__name:=controller", "__ns:=/PSM1"],
    )  # fmt: skip
    ros_graph.wait_for(rig.connected, 20.0, "the nodelet's connections")
    rig.enable()


DESCRIPTION = "/PSM1/robot_description"
BROKEN = [
    ({"cell": "/nowhere/at/all"}, "No such file"),
    ({"arm": "PSM9"}, "PSM1"),
    ({"mode": "freerunn"}, "lockstep, freerun"),
    ({"law": "mine"}, "ours, velocity, paper"),
    ({"lnk": "joint"}, "unknown parameter ~lnk; allowed: arm, black_box, cell"),
    ({"feedback_gain": -3.0}, "0 to 100"),
    ({"participants": 3}, "names"),
    ({"realtime": True}, "lock-step"),
]


@pytest.mark.parametrize(("change", "part"), BROKEN)
def test_f15_broken_parameters_exit_with_2(
    ros_graph: RosGraph, change: dict[str, object], part: str
) -> None:
    settings: dict[str, object] = {"cell": CELL, "arm": "PSM1", **change}
    child = ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", settings)
    assert child.process.wait(20) == 2
    assert part in child.log_tail(20)


def test_the_node_has_the_loader_s_verdict_on_a_urdf(
    ros_graph: RosGraph, tmp_path: Path, full: bool
) -> None:
    def described() -> bool:
        return bool(master.call(ros_graph.uri, "hasParam", DESCRIPTION))

    variants = urdf_variants.draw(tmp_path, 30, seed=49)
    each = len(variants) if full else 2
    usable = [variant for variant in variants if variant.wanted][:each]
    refused = [variant for variant in variants if not variant.wanted][:each]
    for number, variant in enumerate(refused + usable):
        cell = urdf_variants.write_cell(tmp_path / str(number), variant)
        settings: dict[str, object] = {"cell": str(cell), "arm": "PSM1"}
        child = ros_graph.node("surg_control", "rcm_node", f"/PSM1/controller{number}", settings)
        if not variant.wanted:
            assert child.process.wait(20) == 2
            assert variant.robot.with_suffix(".urdf").name in child.log_tail(20)
            continue
        ros_graph.wait_for(described, 20.0, str(variant.changes))
        urdf = master.call(ros_graph.uri, "getParam", DESCRIPTION)
        text = surg_core.load_urdf(variant.robot.with_suffix(".urdf")).text
        assert urdf == text.replace("\r\n", "\n")  # XML-RPC knows one line end
        assert child.process.poll() is None
        master.call(ros_graph.uri, "deleteParam", DESCRIPTION)
        child.process.send_signal(signal.SIGINT)
        child.process.wait(20)
    print(f"{len(usable)} usable, {len(refused)} refused")


def test_parameters_are_read_once(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    rig.enable()
    master.call(ros_graph.uri, "setParam", "/PSM1/controller/law", "paper")
    master.call(ros_graph.uri, "setParam", "/PSM1/controller/cell", "/nowhere")
    assert rig.step().state == Cycle.ENABLED
    urdf = master.call(ros_graph.uri, "getParam", DESCRIPTION)
    assert urdf == Path(rig.arm.urdf_path).read_text("utf-8")
