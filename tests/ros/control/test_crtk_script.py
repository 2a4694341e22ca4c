"""CRTK in one script: an ordinary client drives the arm, with nothing but public names.

The long script runs in lock-step, so that its five seconds of pause cost little and its deadlines
are exact; the frozen client runs in real time, because only a real process can be stopped.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64, String

from helpers.graph.crtk_client import TICK, Arm, LockstepTime, position, shifted
from helpers.graph.ros import RosGraph
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import Cycle, GroundTruth

pytestmark = pytest.mark.ros

CELLS = {name: paths.ROOT / "cells" / name for name in ("sim_ur5e", "sim_panda")}
SCRIPT = paths.ROOT / "tests" / "helpers" / "graph" / "crtk_script.py"


@dataclass
class Witness:
    """What an observer sees who is not the client: cycles, truth, words."""

    cycles: dict[int, Cycle] = field(default_factory=dict)
    deviation: list[float] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    second: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._subscribers = [
            rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, **keys),
            rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._on_truth, **keys),
            rospy.Subscriber("/test/second", String, lambda m: self.second.append(m.data)),
            *(
                rospy.Subscriber(f"/PSM1/{t}", String, lambda m: self.words.append(m.data))
                for t in ("warning", "error")
            ),
        ]

    def _on_cycle(self, message: Cycle) -> None:
        self.cycles[message.tick] = message

    def _on_truth(self, message: GroundTruth) -> None:
        arm = message.arms[0]
        s = np.array([arm.shaft_axis.x, arm.shaft_axis.y, arm.shaft_axis.z])
        d = np.array(
            [getattr(arm.trocar, i) - getattr(arm.shaft_point, i) for i in ("x", "y", "z")]
        )
        self.deviation.append(float(np.linalg.norm(d - (d @ s) * s)))

    def newest(self) -> Cycle:
        return self.cycles[max(self.cycles)]

    def said(self, part: str) -> list[str]:
        return [text for text in self.words if part in text]

    def path(self, first: int, last: int) -> float:
        """Length of the tip's way between two ticks [m]."""
        tips = [self.cycles[k].p_tip for k in range(first, last + 1) if k in self.cycles]
        return float(np.linalg.norm(np.diff(np.array(tips), axis=0), axis=1).sum())

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()


@pytest.fixture
def witness(rospy_node: str) -> Iterator[Witness]:
    made = Witness()
    yield made
    made.close()


def second_script(graph: RosGraph, *words: str) -> Child:
    """The script of another node, in a process of its own."""
    python_path = f"{paths.ROOT / 'tests'}:{os.environ.get('PYTHONPATH', '')}"
    argv = [sys.executable, str(SCRIPT), *words, "__name:=second"]
    return graph.supervisor.start("/second", argv, extra_env={"PYTHONPATH": python_path})


def start_system(graph: RosGraph, cell: Path, mode: str, participants: list[str]) -> None:
    shared = {"cell": cell, "mode": mode, "participants": participants}
    graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})


@pytest.mark.parametrize("cell", [pytest.param("sim_ur5e", marks=pytest.mark.full), "sim_panda"])
def test_one_script_drives_both_robots(
    ros_graph: RosGraph, rospy_node: str, witness: Witness, cell: str, full: bool
) -> None:
    """The second robot has the script alone: what is not there, and who comes next, is the same."""
    began = time.monotonic()
    whole = full or cell == "sim_ur5e"
    others = ["second"] if whole else []
    start_system(ros_graph, CELLS[cell], "lockstep", [rospy_node.lstrip("/"), *others])
    ros_graph.node("surg_dvrk_compat", "dvrk_compat_node.py", "/dvrk_compat", {"arms": ["PSM1"]})
    if whole:
        second_script(ros_graph, "visit", "--lockstep")
    clock = LockstepTime(rospy_node, "PSM1")
    arm = Arm("PSM1", clock, dvrk=True)
    go = rospy.Publisher("/test/go", Empty, latch=True, queue_size=1)
    try:
        arm.check_connections(30.0)
        ros_graph.wait_for(clock.connected, 20.0, "the clock's connections")
        if whole:
            ros_graph.wait_for(lambda: "connected" in witness.second, 30.0, "the second script")
        ros_graph.wait_for(lambda: witness._subscribers[1].get_num_connections() > 0, 10, "truth")
        run_script(arm, clock, witness, pause=5.0 if whole else 1.0)
        if whole:
            ask_for_what_is_not_there(arm, witness)
            hand_over(arm, clock, witness, go)
    finally:
        arm.close()
        clock.close()
        go.unregister()
    assert set(arm.words) == {"enable", "home"}, "no 'resume' was ever needed"
    ros_graph.wait_for(lambda: clock.tick in witness.cycles, 10.0, "the last cycle")
    errors = [cycle.rcm_error for cycle in witness.cycles.values() if cycle.state == Cycle.ENABLED]
    print(
        f"{cell}: {clock.tick} ticks in {time.monotonic() - began:.1f} s; RCM deviation max "
        f"{max(errors) * 1e6:.1f} um, true {max(witness.deviation) * 1e6:.1f} um (simulation)"
    )
    assert max(errors) < 200e-6 and max(witness.deviation) < 300e-6
    assert Cycle.FAULT not in {cycle.state for cycle in witness.cycles.values()}


def hand_over(arm: Arm, clock: LockstepTime, witness: Witness, go: rospy.Publisher) -> None:
    """Another node, right after: authority is free once the arm has rested for 0.5 s."""
    arm.sleep(0.5)
    before = clock.tick
    go.publish(Empty())
    assert arm.time.until(lambda: len(witness.second) > 1, 60.0), "the second script's end"
    assert witness.second[1:] == ["ok"], witness.words
    print(f"second script: {(clock.tick - before) * TICK:.2f} s")


def run_script(arm: Arm, clock: LockstepTime, witness: Witness, pause: float) -> None:
    """The script: each step is what a user writes; each assertion is what he expects."""
    arm.sleep(0.02)  # an arm that runs has a joint state; at tick 1 there is none yet
    assert arm.enable(2.0)
    assert arm.home(2.0)
    assert arm.state.state == "ENABLED" and arm.state.is_homed

    # A stream of poses that simply ends, then seconds of nothing.
    start = arm.setpoint_cp()
    for k in range(1, 51):
        last = shifted(start, (0.01 * (1 - math.cos(math.pi * k / 50)) / 2, 0.0, 0.0))
        arm.servo_cp(last)
        arm.sleep(0.01)
    arm.sleep(pause)
    assert arm.state.state == "ENABLED" and not arm.state.is_busy
    assert math.dist(position(arm.measured_cp()), position(last)) < 5e-4
    assert witness.said("silent") or witness.said("stale") or witness.said("servo_timeout")
    rest = clock.tick
    still = min(1000, round((pause - 0.6) / TICK))
    assert witness.path(rest - still, rest) < 2e-5, "at rest for the last two seconds, if so many"

    # 20 mm further, the orientation left as it was, and wait.
    goal = shifted(arm.setpoint_cp(), (0.02, 0.0, 0.0))
    edges, before = arm.busy_edges, clock.tick
    assert arm.move_cp(goal).wait(timeout=10.0)
    assert arm.busy_edges == edges + 1
    assert math.dist(position(arm.measured_cp()), position(goal)) < 6e-4
    print(f"move_cp of 20 mm: {(clock.tick - before) * TICK:.2f} s")

    # No way at all to go: the edge of is_busy must be there all the same.
    edges, before = arm.busy_edges, clock.tick
    assert arm.move_cp(arm.setpoint_cp()).wait(timeout=10.0)
    assert arm.busy_edges == edges + 1
    assert (clock.tick - before) * TICK <= 1.0

    # One velocity and silence: it goes on for the time-out at most and stops.
    before = clock.tick
    arm.servo_cv((0.02, 0.0, 0.0))
    arm.sleep(1.0)
    way = witness.path(before, clock.tick)
    print(f"servo_cv of 20 mm/s, once: {way * 1e3:.2f} mm")
    assert 0.0005 < way < 0.02 * 0.1 + 0.001
    assert arm.state.state == "ENABLED"
    assert witness.path(clock.tick - 200, clock.tick) < 2e-5

    # Joints, absolute and relative.
    joints = arm.setpoint_jp()
    goal_jp = joints + np.array([0.05, -0.05, 0.005, 0.2])
    assert arm.move_jp(goal_jp).wait(timeout=10.0)
    assert np.allclose(arm.measured_jp(), goal_jp, atol=[0.005, 0.005, 5e-4, 0.011])
    assert arm.move_jr(np.array([-0.05, 0.05, -0.005, -0.2])).wait(timeout=10.0)
    assert np.allclose(arm.measured_jp(), joints, atol=[0.01, 0.01, 1e-3, 0.022])
    assert arm.move_jp(arm.setpoint_jp()).wait(timeout=10.0), "of zero length"

    # Hold in the middle of a move: the move is over, and the arm stays where it stopped.
    handle = arm.move_jp(joints + np.array([0.2, 0.0, 0.0, 0.0]))
    assert handle.wait(is_busy=True, timeout=1.0)
    arm.sleep(0.15)
    arm.hold()
    assert handle.wait(timeout=1.0)
    arm.sleep(0.4)
    stopped = arm.measured_jp()
    assert 0.005 < stopped[0] - joints[0] < 0.19
    arm.sleep(0.3)
    assert abs(arm.measured_jp()[0] - stopped[0]) < 1e-4

    # The jaw, with the angles that dVRK scripts use.
    assert arm.jaw.open_jaw().wait(timeout=10.0)
    opened = arm.jaw.get("measured_js").position[0]
    assert arm.jaw.close_jaw().wait(timeout=10.0)
    assert opened - arm.jaw.get("measured_js").position[0] > 0.5

    # And on it goes: no state was left behind.
    assert arm.move_cp(start).wait(timeout=10.0)
    assert math.dist(position(arm.measured_cp()), position(start)) < 6e-4


def ask_for_what_is_not_there(arm: Arm, witness: Witness) -> None:
    """Every topic of the compatibility node: answered in words, and nothing moves."""
    arm.sleep(0.6)  # at rest, the last move's end included
    before = max(witness.cycles)
    posture = np.array(witness.newest().q)
    arm.free(Empty())
    arm.servo_jf(JointState(effort=[1.0] * 4))
    for group in (arm.spatial, arm.body):
        group.servo_cf(WrenchStamped())
    arm.set_absolute(Bool(True))
    arm.use_gravity_compensation(Bool(False))
    arm.set_ratio(Float64(0.1))
    arm.jaw.servo_jf(JointState(effort=[0.1]))
    arm.set_tool_present(Bool(True))
    topics = [
        *("free", "servo_jf", "spatial/servo_cf", "body/servo_cf", "jaw/servo_jf"),
        *("body/set_cf_orientation_absolute", "use_gravity_compensation"),
        *("trajectory_j/set_ratio", "emulate_tool_present"),
    ]
    assert arm.time.until(
        lambda: all(witness.said(f": {topic} from ") for topic in topics), 20.0
    ), witness.words
    assert witness.newest().refused == 0
    assert witness.path(before, max(witness.cycles)) < 2e-5
    assert np.abs(np.array(witness.newest().q) - posture).max() < 5e-5
    assert arm.newest["trajectory_j/ratio"].data == 1.0
    assert arm.spatial.newest["measured_cf"].header.stamp.is_zero()


def test_a_move_into_a_joint_limit_ends_and_wait_returns(
    ros_graph: RosGraph, rospy_node: str, witness: Witness
) -> None:
    """F20: the Panda's last joint ends before a roll of 4 rad; an ordinary client waits for it."""
    start_system(ros_graph, CELLS["sim_panda"], "lockstep", [rospy_node.lstrip("/")])
    clock = LockstepTime(rospy_node, "PSM1")
    arm = Arm("PSM1", clock)
    try:
        arm.check_connections(30.0)
        ros_graph.wait_for(clock.connected, 20.0, "the clock's connections")
        arm.sleep(0.02)
        assert arm.enable(2.0) and arm.home(2.0)
        home = arm.measured_jp()
        assert arm.move_jp(home + np.array([0.0, 0.0, 0.0, 4.0])).wait(timeout=30.0)
        over = clock.tick
        assert abs(arm.measured_jp()[3] - home[3]) < 3.5
        ros_graph.wait_for(lambda: over in witness.cycles, 10.0, "the cycle in which it was over")
        q = np.array([witness.cycles[k].q for k in sorted(witness.cycles) if k <= over])
        moving = np.abs(np.diff(q, axis=0)).max(axis=1) > 0.01 * TICK
        stood = (len(moving) - np.flatnonzero(moving)[-1]) * TICK
        print(f"busy for {stood:.2f} s after standstill")
        assert stood < 2.0
        assert any("joint_limit" in text for text in witness.said("without reaching"))
        assert arm.move_jp(home).wait(timeout=30.0), "and the arm obeys again"
        assert np.allclose(arm.measured_jp(), home, atol=[0.005, 0.005, 5e-4, 0.011])
    finally:
        arm.close()
        clock.close()


def test_a_client_that_was_frozen_does_not_go_on(
    ros_graph: RosGraph, rospy_node: str, witness: Witness
) -> None:
    """F03: SIGSTOP of a streaming client for 2 s; standstill, and none of its motion afterwards.

    Its poses follow the clock, so on waking they are far from where the arm stopped. A stream that
    counts its poses goes on where it was cut off, which nobody can tell from a new one: such a
    stream is accepted within 2 mm of the set-point, as any is.
    """
    start_system(ros_graph, CELLS["sim_ur5e"], "freerun", [])
    child = second_script(ros_graph, "stream")
    speed = lambda: float(np.linalg.norm(witness.newest().v_set))  # noqa: E731

    def streaming() -> bool:
        return bool(witness.cycles) and speed() > 0.01

    ros_graph.wait_for(lambda: streaming() or child.exit_code is not None, 40.0, "the stream")
    assert child.exit_code is None, (witness.second, witness.words)
    time.sleep(0.4)
    stopped_at = time.monotonic()
    child.process.send_signal(signal.SIGSTOP)
    try:
        moving = [cycle for cycle in witness.cycles.values() if cycle.state == Cycle.ENABLED]
        assert max(np.linalg.norm(cycle.v_set) for cycle in moving) > 0.01
        while speed() > 1e-6 and time.monotonic() < stopped_at + 5.0:
            time.sleep(0.005)
        still = time.monotonic() - stopped_at
        print(f"standstill {still * 1e3:.0f} ms of wall clock after SIGSTOP")
        assert still < 0.5
        time.sleep(max(0.0, stopped_at + 2.0 - time.monotonic()))
        at_wake, posture = max(witness.cycles), np.array(witness.newest().q)
    finally:
        child.process.send_signal(signal.SIGCONT)
    refused = witness.newest().refused
    ros_graph.wait_for(
        lambda: max(witness.cycles) > at_wake + 300 and witness.newest().refused > refused + 10,
        60.0,
        "the refusals",
    )
    now = witness.newest()
    assert child.exit_code is None, "it goes on sending"
    # A simulator that gets no core for 50 ms ends in FAULT: that is the link's, not the client's.
    assert now.state == Cycle.ENABLED or (now.state, now.reason) == (Cycle.FAULT, "link")
    assert witness.path(at_wake, max(witness.cycles)) < 1e-4
    assert np.abs(np.array(now.q) - posture).max() < 1e-4
