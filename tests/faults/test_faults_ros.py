"""Faults of real processes: forces on topics, strangers, a controller that is frozen or killed.

Times are of this machine's clocks, with whatever else it does; deadlines in cycles are the core's
tests' business.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from crtk_msgs.msg import StringStamped
from helpers.graph import failing_clock
from helpers.graph.control_rig import ANSWER_S, CELL, Rig, start, tip_in_rcm
from helpers.graph.ros import RosGraph
from helpers.results.reactions import Reactions
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import Cycle, GroundTruth, Ready

pytestmark = pytest.mark.ros

FOLLOWED = 0.3
"""Share of its commanded speed below which an arm may count as standing still."""

HALF = 0.5
"""Share of the ticks that a simulator makes which is always behind."""

BRIDGE_MS = 40 + 60
"""The simulated link's dead-man and its ramp."""
MACHINE_MS = 90
"""What a shared machine may add."""


# --- a fake link, tick by tick --------------------------------------------------------------


class Sensor:
    """A force sensor on a topic; what it says is there before the next tick."""

    def __init__(self, graph: RosGraph, topic: str) -> None:
        self._publisher = rospy.Publisher(f"/PSM1/{topic}", WrenchStamped, queue_size=1)
        graph.wait_for(lambda: self._publisher.get_num_connections() > 0, ANSWER_S, topic)

    def say(self, newton: float, frame: str = "PSM1_base") -> None:
        """A force along x."""
        message = WrenchStamped()
        message.header.frame_id = frame
        message.header.stamp = rospy.Time(1)
        message.wrench.force.x = newton
        self._publisher.publish(message)
        time.sleep(0.05)


def move(rig: Rig, ticks: int) -> Cycle:
    """Sideways at 10 mm/s from where the arm is."""
    begin = tip_in_rcm(cycle := rig.step())
    for k in range(ticks):
        rig.pose(begin + np.array([2e-5 * (k + 1), 0.0, 0.0]))
        cycle = rig.step()
    return cycle


def enable_again(rig: Rig) -> None:
    """From PAUSED or FAULT."""
    for word in ("disable", "enable"):
        rig.say(word)
        cycle = rig.step()
    assert cycle.state == Cycle.ENABLED, rig.texts


def test_f25_forces_on_topics_stop_the_arm(
    ros_graph: RosGraph, rig: Rig, reactions: Reactions, full: bool
) -> None:
    start(ros_graph, rig)
    tip = Sensor(ros_graph, "tool/measured_cf")
    trocar = Sensor(ros_graph, "trocar/measured_cf")
    rig.enable()
    hard: list[int] = []
    load: list[int] = []
    soft, silent = [], []

    def calm() -> None:
        for sensor in (tip, trocar):
            sensor.say(0.0)
        rig.step()

    for _ in range(5 if full else 1):
        for sensor, newton, found in ((tip, 8.1, hard), (trocar, 15.1, load)):
            assert move(rig, 30).state == Cycle.ENABLED
            sensor.say(newton)
            cycle = rig.step()
            assert (cycle.state, cycle.reason) == (Cycle.FAULT, "force")
            found.append(0)
            assert np.any(cycle.qd_command)  # it fades, or follows a ramp
            rig.say("enable")
            assert rig.step().state == Cycle.FAULT, "refused while it lasts"
            for _ in range(20):
                rig.step()
            calm()
            enable_again(rig)
        move(rig, 30)
        calm()
        tip.say(-5.1)
        waited = 0
        while rig.step().state != Cycle.PAUSED and waited < 60:
            waited += 1
        soft.append(waited)
        calm()
        enable_again(rig)
        for n in range(120):
            if n % 40 == 0:
                tip.say(0.0)
            cycle = rig.step()
            if cycle.state == Cycle.FAULT:
                break
        assert cycle.reason == "force"
        silent.append(n)
        calm()
        enable_again(rig)
    tip.say(100.0, frame="world")
    assert rig.step().state == Cycle.ENABLED
    rig.wait_text("warning", "allowed is 'PSM1_base'")
    reactions.add("F25", "tool/measured_cf above 8 N, the node", "FAULT(force), zero", hard, 0)
    reactions.add("F25", "trocar/measured_cf above 15 N, the node", "FAULT(force)", load, 0)
    reactions.add("F25", "tool/measured_cf above 5 N, the node", "PAUSED(force)", soft, 50)
    reactions.add("F25", "force sensor falls silent, the node", "FAULT(force)", silent, 101)


def test_f22_a_cell_without_a_trocar_does_not_start(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    text = (cell / "cell.yaml").read_text("utf-8")
    shipped = paths.ROOT / "src" / "surg_description"
    (cell / "cell.yaml").write_text(text.replace("../../src/surg_description", str(shipped)))
    (cell / "calibration" / "trocar_PSM1.yaml").unlink()
    child = ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", {"cell": cell})
    assert child.process.wait(20) == 2
    assert "trocar_PSM1.yaml" in child.log_tail(20)


def test_f26_a_stranger_is_not_obeyed_and_may_stop_the_arm(
    ros_graph: RosGraph, rig: Rig, reactions: Reactions, full: bool
) -> None:
    words = ("hold", "pause", "disable") * (2 if full else 1)
    begins = [10 + 700 * n for n in range(len(words))]
    plan: dict[int, list[str]] = {}
    for tick, word in zip(begins, words, strict=True):
        plan |= {tick + 50: ["stream"], tick + 400: ["quiet", word]}
    heard: list[Ready] = []
    ear = rospy.Subscriber("/sim/ready", Ready, heard.append, queue_size=None)
    start(ros_graph, rig, participants=[rig.name, "stranger"])
    python_path = f"{paths.ROOT / 'tests'}:{os.environ.get('PYTHONPATH', '')}"
    script = paths.ROOT / "tests" / "helpers" / "graph" / "second_sender.py"
    ros_graph.supervisor.start(
        "/stranger", [sys.executable, str(script), json.dumps(plan)],
        extra_env={"PYTHONPATH": python_path},
    )  # fmt: skip
    ros_graph.wait_for(lambda: "stranger" in {r.participant for r in heard}, 20.0, "the stranger")
    others, still = [], []
    cycle = rig.enable()
    for begin in begins:
        while rig.tick < begin - 1:
            cycle = rig.step()
        p0, refused, seen = tip_in_rcm(cycle), cycle.refused, []
        while len(seen) < 400 or (len(seen) < 650 and np.any(cycle.v_set)):
            rig.pose(p0 + np.array([4e-5 * (len(seen) + 1), 0.0, 0.0]))
            seen.append(cycle := rig.step())
        rest = rig.tick
        before = [c for c in seen if begin + 50 <= c.tick < begin + 400]
        assert len(before) == 350 and {c.source for c in before} == {f"/{rig.name}"}
        assert all(np.linalg.norm(c.v_set) > 1e-3 for c in before[50:])
        others.append(1e6 * float(np.abs([(tip_in_rcm(c) - p0)[1:] for c in before]).max()))
        assert before[-1].refused == refused + 350
        still.append(2.0 * (rest - (begin + 400)))
        enable_again(rig)
    ear.unregister()
    assert "/stranger" in rig.wait_text("warning", "another node holds the arm")
    name = "a second sender at 500 Hz, the node"
    reactions.add("F26", name, "tip aside of the holder's line", others, 200, "µm")
    reactions.add("F26", "hold, pause, disable by it, the node", "standstill", still, 300, "ms")


# --- the simulator in real time -------------------------------------------------------------


class System:
    """Simulator and controller in free-run, and a hand that moves the tip to and fro."""

    def __init__(self, graph: RosGraph, **environment: str) -> None:
        self.graph = graph
        shared = {"cell": CELL, "mode": "freerun"}
        bridge = {**shared, "inject": True}
        self.bridge = graph.node("surg_sim", "bridge_node.py", "/sim", bridge, environment)
        self.cycles: list[Cycle] = []
        self.truths: list[tuple[int, float, float]] = []  # tick, tip speed, deviation
        self.texts: list[str] = []
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._ears = [
            rospy.Subscriber("/PSM1/cycle", Cycle, self.cycles.append, **keys),
            rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._on_truth, **keys),
            rospy.Subscriber("/PSM1/warning", String, lambda m: self.texts.append(m.data)),
        ]
        self._stream = rospy.Publisher("/PSM1/servo_cv", TwistStamped, queue_size=1)
        self._word = rospy.Publisher("/PSM1/state_command", StringStamped, queue_size=10)
        self._inject = rospy.Publisher("/sim/inject", String, queue_size=10)
        self._stop = threading.Event()
        self.controller = self.start_controller()
        self._thread = threading.Thread(target=self._hand)
        self._thread.start()

    def start_controller(self, env: dict[str, str] | None = None) -> Child:
        """A new controller; the simulator goes on."""
        before = len(self.cycles)
        params = {"cell": CELL, "mode": "freerun", "arm": "PSM1"}
        self.controller = self.graph.node(
            "surg_control", "rcm_node", "/PSM1/controller", params, env=env
        )
        self.graph.wait_for(lambda: len(self.cycles) > before + 100, 30.0, "cycles")
        return self.controller

    def _on_truth(self, message: GroundTruth) -> None:
        arm = message.arms[0]
        v = arm.tip_velocity
        s = np.array([arm.shaft_axis.x, arm.shaft_axis.y, arm.shaft_axis.z])
        d = np.array([getattr(arm.trocar, i) - getattr(arm.shaft_point, i) for i in "xyz"])
        away = float(np.linalg.norm(d - (d @ s) * s))
        self.truths.append((message.tick, float(np.linalg.norm([v.x, v.y, v.z])), away))

    def _hand(self) -> None:
        sign = 1.0
        while not self._stop.wait(0.01):
            x = tip_in_rcm(self.cycles[-1])[0]
            sign = -1.0 if x > 0.015 else 1.0 if x < -0.015 else sign
            message = TwistStamped()
            message.twist.linear.x = 0.03 * sign
            self._stream.publish(message)

    def quiet(self) -> None:
        """DISABLED, wherever the arm is."""
        self._word.publish(StringStamped(string="disable"))
        self.graph.wait_for(lambda: self.cycles[-1].state == Cycle.DISABLED, ANSWER_S, "DISABLED")

    def in_motion(self) -> None:
        """Enable where needed and wait until the arm moves."""
        asked = 0.0

        def moves() -> bool:
            nonlocal asked
            now, cycle = time.monotonic(), self.cycles[-1]
            if cycle.state != Cycle.ENABLED and now > asked + 0.3:
                words = ("resume",) if cycle.state == Cycle.PAUSED else ("home", "enable")
                for word in words:
                    self._word.publish(StringStamped(string=word))
                asked = now
            fast = float(np.linalg.norm(cycle.v_set)) > 0.025 and self.truths[-1][1] > 0.015
            return bool(cycle.state == Cycle.ENABLED) and fast

        self.graph.wait_for(moves, 15.0, "motion")

    def still_after(self, tick: int) -> float:
        """Milliseconds of the simulator from a tick to the true tip's standstill."""

        def rest() -> int:
            late = [t for t, speed, _ in self.truths[-2000:] if t > tick and speed < 1e-3]
            return late[0] if late else 0

        self.graph.wait_for(lambda: rest() > 0, 5.0, "standstill of the simulated arm")
        return 2.0 * (rest() - tick)

    def wait_warning(self, part: str, first: int) -> None:
        """Wait for a warning, the first ones left out."""
        self.graph.wait_for(
            lambda: any(part in text for text in self.texts[first:]), 3.0, f"a warning of {part!r}"
        )

    def inject(self, fault: str) -> None:
        """A fault on purpose in the simulator."""
        self._inject.publish(String(fault))

    def jumps(self, first: int = 0) -> float:
        """Largest change of a joint's command from cycle to cycle, over its limit a T.

        Behind a gap the arm may have been stopped: there the change counts from what was measured.
        """
        worst = 0.0
        cycles = self.cycles[first:]
        for a, b in itertools.pairwise(cycles):
            halt = b.state == Cycle.FAULT and not np.any(b.qd_command)
            if b.tick == a.tick + 1 and not halt:
                stopped = a.state != b.state and b.reason == "not_following"
                taken_up = b.period_us > 10_000 or stopped
                before = b.qd if taken_up else a.qd_command
                change = np.abs(np.subtract(b.qd_command, before)).max()
                worst = max(worst, float(change) / (40.0 * 0.002))
        return worst

    def close(self) -> None:
        """Leave the graph."""
        self._stop.set()
        self._thread.join()
        for topic in [*self._ears, self._stream, self._word, self._inject]:
            topic.unregister()


@pytest.fixture
def system(ros_graph: RosGraph, rospy_node: str) -> Iterator[System]:
    """Simulator and controller."""
    made = System(ros_graph)
    yield made
    made.close()


def test_f27_f10_a_frozen_controller(system: System, reactions: Reactions, full: bool) -> None:
    runs = 8 if full else 2
    jumps, frozen, still = [], [], []
    for _ in range(runs):  # 50 ms: it wakes up before the link has noticed
        system.in_motion()
        first = len(system.cycles)
        system.controller.process.send_signal(signal.SIGSTOP)
        time.sleep(0.05)
        system.controller.process.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        jumps.append(system.jumps(first - 1))
        frozen.append(1e-3 * max(c.period_us for c in system.cycles[first:]))
    assert max(frozen) > 40, "it was never frozen"
    for _ in range(runs):  # longer: the link stops the arm by itself
        system.in_motion()
        tick, first = system.truths[-1][0], len(system.cycles)
        system.controller.process.send_signal(signal.SIGSTOP)
        try:
            still.append(system.still_after(tick))
        finally:
            system.controller.process.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        assert system.jumps(first - 1) <= 1 + 1e-6
    print(f"frozen for {max(frozen):.0f} ms at most; states after: "
          f"{sorted({(c.state, c.reason) for c in system.cycles})}")  # fmt: skip
    name = "controller stopped by SIGSTOP for 50 ms"
    reactions.add("F27", name, "change of a joint's command / (a T)", jumps, 1 + 1e-6, "1")
    limit = BRIDGE_MS + MACHINE_MS
    reactions.add(
        "F10", "controller frozen by SIGSTOP", "simulated tip at rest", still, limit, "ms"
    )


def test_f27_a_starved_controller(system: System, reactions: Reactions, full: bool) -> None:
    """Each of its rare commands comes before the link would stop the arm by itself."""
    gaps, still = [], []
    for _ in range(8 if full else 2):
        system.in_motion()
        tick, first = system.truths[-1][0], len(system.cycles)
        began = time.monotonic()
        while time.monotonic() - began < 0.8:
            system.controller.process.send_signal(signal.SIGSTOP)
            time.sleep(0.025)
            system.controller.process.send_signal(signal.SIGCONT)
            time.sleep(0.001)
        still.append(system.still_after(tick))
        paused = [k for k, c in enumerate(system.cycles) if k > first and c.reason == "overrun"]
        assert paused, "PAUSED(overrun) never came"
        gaps.append(0.0)
        for cycle in reversed(system.cycles[first : paused[0] + 1]):
            if cycle.period_us <= 10_000:
                break
            gaps[-1] += 1e-3 * cycle.period_us
    longest = 50 + 25 + MACHINE_MS
    reactions.add("F27", "starved controller", "PAUSED(overrun) after gaps of", gaps, longest, "ms")
    limit = longest + BRIDGE_MS
    reactions.add("F27", "starved controller", "simulated tip at rest", still, limit, "ms")


def test_f10_a_simulator_that_is_always_behind(
    ros_graph: RosGraph, rospy_node: str, reactions: Reactions, full: bool
) -> None:
    """It ticks without a pause and holds its lock meanwhile: it still obeys the newest command."""
    starved = System(ros_graph)
    try:
        starved.in_motion()
        ticks, cycles = len(starved.truths), len(starved.cycles)
        overruns = starved.cycles[-1].overruns
        first = starved.truths[-1][0]
        until = time.monotonic() + (30 if full else 5)
        while time.monotonic() < until:
            # Stopped whenever it has made more than half of the ticks, on a slow machine as well.
            made = starved.truths[-1][0] - first
            if made > HALF * (len(starved.cycles) - cycles):
                starved.bridge.process.send_signal(signal.SIGSTOP)
                time.sleep(0.01)
                starved.bridge.process.send_signal(signal.SIGCONT)
            time.sleep(0.001)
        truths, cycle = starved.truths[ticks:], starved.cycles[-1]
    finally:
        starved.close()
    ran = (truths[-1][0] - truths[0][0]) / (len(starved.cycles) - cycles)
    away = [1e3 * max(d for _, _, d in truths)]
    print(f"{len(truths)} ticks at {ran:.2f} of real time, {cycle.state} {cycle.reason!r}")
    assert ran < 0.9, "it was never behind"
    # Whatever else runs here may silence the link for 0.1 s, or make the controller itself late:
    # those are other faults, and it names them.
    # An arm that moves at less than a quarter of what is commanded does not follow.
    slow = ran < FOLLOWED and cycle.reason == "not_following"
    busy = cycle.reason == "link" or (cycle.reason == "overrun" and cycle.overruns > overruns)
    assert cycle.state == Cycle.ENABLED or busy or slow, cycle.reason
    reactions.add("F10", "simulator always behind", "true deviation", away, 2.5, "mm")


def test_f23_an_arm_is_led_home_by_hand(system: System) -> None:
    """Not while its controller moves it; and the controller takes it up again."""
    guide_home = rospy.Publisher("/sim/guide_home", String, queue_size=10)
    system.graph.wait_for(lambda: guide_home.get_num_connections() > 0, ANSWER_S, "/sim")
    home = np.asarray(surg_core.load_cell(str(CELL)).arms["PSM1"].robot.home)

    def off() -> float:
        return float(np.abs(np.subtract(system.cycles[-1].q, home)).max())

    system.in_motion()
    guide_home.publish("PSM1")
    guide_home.publish("nobody")
    system.in_motion()
    system.graph.wait_for(lambda: off() > 0.015, 10.0, "the arm away from home")
    system.quiet()
    time.sleep(0.3)
    moved = off()
    assert moved > 0.005, "it is at home already"
    guide_home.publish("PSM1")
    system.graph.wait_for(lambda: off() < 1e-3, 20.0, "the arm at home")
    assert system.cycles[-1].state == Cycle.DISABLED
    print(f"led home from {moved:.3f} rad; {off():.5f} rad are left")
    system.in_motion()


def test_f28_an_exception_in_the_control_thread_ends_with_a_zero_command(
    system: System, reactions: Reactions, tmp_path: Path
) -> None:
    commands: list[np.ndarray] = []
    ear = rospy.Subscriber(
        "/PSM1/robot/servo_jv",
        JointState,
        lambda m: commands.append(np.array(m.velocity)),
        queue_size=None,
        tcp_nodelay=True,
    )
    system.quiet()
    system.controller.process.terminate()
    assert system.controller.process.wait(5) == 0
    trigger = tmp_path / "now"
    system.start_controller(failing_clock.environment(trigger))
    system.in_motion()
    assert np.any(commands[-1])
    tick = system.truths[-1][0]
    trigger.touch()
    assert system.controller.process.wait(5) == 1
    assert "the clock failed" in system.controller.log_tail(20)
    ear.unregister()
    assert not np.any(commands[-1]), "the last command is zero"
    name = "an exception in the control thread"
    still = [system.still_after(tick)]
    reactions.add("F28", name, "simulated tip at rest", still, BRIDGE_MS + MACHINE_MS, "ms")


def test_f28_a_killed_controller(system: System, reactions: Reactions, full: bool) -> None:
    still, away = [], []
    for k in range(5 if full else 1):
        if k > 0:
            system.start_controller()
        system.in_motion()
        tick = system.truths[-1][0]
        system.controller.process.kill()
        still.append(system.still_after(tick))
        system.controller.process.wait(5)
        away.append(1e3 * max(d for t, _, d in system.truths[-3000:] if t > tick))
    limit = BRIDGE_MS + MACHINE_MS
    reactions.add("F28", "controller killed (-9)", "simulated tip at rest", still, limit, "ms")
    reactions.add("F28", "controller killed (-9)", "true deviation", away, 2.0, "mm")


def test_f31_a_lost_tool_link_is_said(system: System, reactions: Reactions, full: bool) -> None:
    still, jaws = [], []
    for _ in range(5 if full else 1):
        system.in_motion()
        before, tick = len(system.texts), system.truths[-1][0]
        system.inject('{"fault": "tool_lost", "ticks": 500}')
        still.append(system.still_after(tick))
        system.wait_warning("tool link", before)
        held = [c for c in system.cycles[-50:] if c.reason == "tool_lost"]
        assert held and {c.state for c in held} == {Cycle.ENABLED}
        jaws.append(float(np.ptp([c.jaw_set for c in held])))
        time.sleep(1.0)  # back again: the hand still streams, and only that moves the arm
    name = "tool link lost, the node"
    limit = 200 + 100 + MACHINE_MS + 50
    reactions.add("F31", name, "simulated tip at rest", still, limit, "ms")
    reactions.add("F31", name, "jaw moves by", jaws, 0.0, "rad")
