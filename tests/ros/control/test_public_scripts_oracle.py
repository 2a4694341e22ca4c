"""Other people's scripts drive the arms, unmodified, on both robots, and from ROS 2 on one.

``SURG_PUBLIC_CLIENTS`` names a folder with checkouts of crtk_python_client and dvrk_python. Judged
are the exit, every ``wait()``, and by the simulator's truth where the tip goes and what the pivot
does. The scripts that cannot work are asserted as well, so that a change is noticed.
"""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rosbag
import rospy
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from helpers.graph import public_scripts
from helpers.graph.crtk_client import Arm, WallTime, shifted
from helpers.graph.pivot_judge import vector
from helpers.graph.public_scripts import Ended, Script, Step
from helpers.graph.ros import RosGraph
from helpers.graph.surg import environment, start
from helpers.results import public_script_results as page
from helpers.ros2 import interfaces
from surg_cli.graph import master
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths
from surg_msgs.msg import Cycle, GroundTruth

pytestmark = [pytest.mark.ros, pytest.mark.oracle]

Array = NDArray[np.float64]
FOUND_HOME = 1.2e-3
"""[m] from where the script asked the tip to be in the end."""
PIVOT = 0.5e-3
"""[m] from the trocar."""
STARVED = {"overrun", "link"}
"""How an arm ends that got no processor for some time: a script is begun anew then."""
TRIES = 4
ROS1 = (Path(sys.executable), dict[str, str]())
ROS2 = pytest.param(page.ROS2, id="rclpy")
"""The scripts with rclpy, on the first cell."""
PLACES = (*page.CELLS, page.ROS2)
"""Where scripts are tried that move no arm, or two."""
STILL_S, HUNG = 6.0, 10
"""[s] More than a script waits for its connections; tries of one that hangs with rclpy."""
ENTER = "\n"
TAUGHT = np.array([0.12, -0.1, 0.01, 0.5, 0.6, -0.5])
"""[rad], insertion [m]: how far the joints of a replayed motion go, a wrist's last."""


@dataclass
class Plant:
    """What the simulated arm did: the truth, not what the controller states."""

    arm: str
    tips: list[Array] = field(default_factory=list)
    axes: list[Array] = field(default_factory=list)
    jaws: list[float] = field(default_factory=list)
    faults: set[str] = field(default_factory=set)
    words: list[str] = field(default_factory=list)
    pivot: float = 0.0
    cycle: Cycle = field(default_factory=Cycle)

    def __post_init__(self) -> None:
        keys = {"queue_size": None, "tcp_nodelay": True}
        texts = (f"/{self.arm}/warning", f"/{self.arm}/error", "/system/warning")
        self.bent: list[tuple[float, ...]] = []
        self._ears = [
            rospy.Subscriber(f"/{self.arm}/tool/measured_js", JointState, self._on_tool, **keys),
            rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._on_truth, **keys),
            rospy.Subscriber(f"/{self.arm}/cycle", Cycle, self._on_cycle, **keys),
            *(rospy.Subscriber(name, String, self._on_words) for name in texts),
        ]

    def _on_truth(self, message: GroundTruth) -> None:
        arm = next(arm for arm in message.arms if arm.arm == self.arm)
        axis, tip = vector(arm.shaft_axis), vector(arm.tip)
        away = vector(arm.trocar) - vector(arm.shaft_point)
        self.pivot = max(self.pivot, float(np.linalg.norm(away - away @ axis * axis)))
        self.trocar = vector(arm.trocar)
        self.tips.append(tip)
        self.axes.append(axis)
        self.jaws.append(arm.jaw)

    def _on_cycle(self, message: Cycle) -> None:
        self.cycle = message
        if message.state in (Cycle.FAULT, Cycle.PAUSED):
            self.faults.add(message.reason)

    def _on_tool(self, message: JointState) -> None:
        said = dict(zip(message.name, message.position, strict=True))
        self.bent.append(tuple(said[name] for name in ("pitch", "yaw") if name in said))

    def turns(self) -> Array:
        """Largest turns of a wrist's joints [rad], none of a straight instrument."""
        return np.abs(np.array(self.bent)).max(axis=0)

    def _on_words(self, message: String) -> None:
        self.words.append(message.data)

    def begin(self) -> None:
        """Forget what was; the tip rests here."""
        for kept in (self.tips, self.axes, self.jaws, self.bent):
            kept.clear()
        self.faults.clear()
        self.pivot = 0.0
        time.sleep(0.1)

    def way(self, origin: Array | None = None) -> tuple[float, float]:
        """Of the tip from where it began, or from a point: the furthest and the last [m]."""
        time.sleep(0.2)
        away = np.linalg.norm(
            np.array(self.tips) - (self.tips[0] if origin is None else origin), axis=1
        )
        return float(away.max()), float(away[-1])

    def depth(self) -> float:
        """Of the tip behind the trocar's point [m]."""
        return float(np.linalg.norm(self.tips[-1] - self.trocar))

    def close(self) -> None:
        """Leave the graph."""
        for ear in self._ears:
            ear.unregister()


@dataclass
class Rig:
    """A running cell with its arm, which may or may not be at home."""

    graph: RosGraph
    cell: str
    plant: Plant
    arm: Arm
    side: tuple[Path, dict[str, str]]  # interpreter and environment of the scripts
    note: Callable[[str, int, str], None]  # of the page: script, waits, what was found
    starved: int = 0

    @property
    def ros2(self) -> bool:
        """Whether the scripts run with rclpy."""
        return self.side is not ROS1

    def homed(self) -> None:
        """Enable and home the arm, as the scripts of crtk_python_client want it."""
        self.graph.wait_for(lambda: self.arm.enable(2.0) and self.arm.home(2.0), 120.0, "home")
        time.sleep(0.5)

    def go_back(self, joints: Array | None) -> bool:
        """Enable anew, and go where a script began that was starved."""
        self.homed()
        return joints is None or self.arm.move_jp(joints).wait(timeout=20.0)

    def compat(self) -> None:
        """The topics that the dVRK's classes insist on."""
        node = self.graph.node(
            "surg_dvrk_compat", "dvrk_compat_node.py", "/dvrk_compat", {"arms": ["PSM1"]}
        )
        ready = lambda: "answers for" in node.log_tail()  # noqa: E731
        self.graph.wait_for(ready, 30.0, "dvrk_compat")

    def begin(self, script: str, *words: str) -> Script:
        """Start a script; what the plant does from now on counts."""
        self.plant.begin()
        python, env = self.side
        return Script(script, words, {**self.graph.env, **env}, python)

    def run(self, script: str, *words: str, steps: Sequence[Step] = (), ends: str = "") -> Ended:
        """A script from its start to its end, which must be a good one.

        ``ends`` is what its last exception says, of a script that always ends with one. Where
        the machine starved the arm, it is begun anew: this judges scripts, not machines.
        """
        homed = self.arm.state.is_homed  # joints are known from then on
        begun = np.array(self.arm.get("measured_js", 1.0, 1.0).position) if homed else None
        for k in range(TRIES):
            running = self.begin(script, *words)
            try:
                running.talk(steps)
                ended = running.end()
            finally:
                running.kill()
            # Its first word may come before DDS knows the script.
            unheard = self.ros2 and "failed to enable" in ended.text
            starved = self.plant.faults and not self.plant.faults - STARVED
            if k + 1 == TRIES or not (starved or unheard):
                break
            self.starved += 1
            self.graph.wait_for(lambda: self.go_back(begun), 120.0, "the arm where it began")
        self.good(ended, ends)
        return ended

    def good(self, ended: Ended, ends: str = "") -> None:
        """No exception, no wait in vain, no fault, and the pivot is kept."""
        if not (ends and ended.text.rstrip().endswith(ends)):
            assert ended.code == 0 and "Traceback" not in ended.text, ended.text
        assert ended.in_vain == 0, ended.text
        assert not self.plant.faults, self.plant.words
        assert self.plant.pivot < PIVOT

    def keep(self, script: str, ended: Ended, result: str) -> None:
        """Keep what was found."""
        said = f"{result}; pivot {1e3 * self.plant.pivot:.3f} mm"
        if self.starved:
            said += f"; begun anew {self.starved} times"
        self.note(script, ended.waits, said)


@pytest.fixture(params=[*page.CELLS, page.WRIST, ROS2])
def rig(ros_graph: RosGraph, rospy_node: str, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """One arm; the checkouts come first, as nothing is started without them."""
    public_scripts.folder()
    cell, side = request.param, ROS1
    note = partial(page.note, place=cell)
    if cell == page.ROS2:
        cell, side = page.CELLS[0], interfaces.with_gateway(ros_graph)
    shared: dict[str, object] = {"cell": paths.ROOT / "cells" / cell, "mode": "freerun"}
    ros_graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
    plant, arm = Plant("PSM1"), Arm("PSM1", WallTime())
    try:
        arm.check_connections(60.0)
        ros_graph.wait_for(lambda: bool(plant.tips), 30.0, "the truth")
        yield Rig(ros_graph, cell, plant, arm, side, note)
    finally:
        arm.close()
        plant.close()


def there_and_back(rig: Rig, script: str, ended: Ended, way: float) -> None:
    """The tip has been so far away [m], and is where it began."""
    far, last = rig.plant.way()
    assert far == pytest.approx(way, abs=FOUND_HOME)
    assert last < FOUND_HOME
    rig.keep(script, ended, f"tip {1e3 * far:.1f} mm away, back to {1e3 * last:.2f}")


def test_crtk_move_cp_example(rig: Rig) -> None:
    """20 mm along x and y, there, beyond and back."""
    rig.homed()
    ended = rig.run("crtk_move_cp_example", "PSM1")
    assert ended.waits == 3
    there_and_back(rig, "crtk_move_cp_example", ended, 0.02 * math.sqrt(2))


def test_crtk_servo_cp_example(rig: Rig) -> None:
    """A stream at 200 Hz, 40 mm along x and y and back."""
    rig.homed()
    ended = rig.run("crtk_servo_cp_example", "PSM1")
    there_and_back(rig, "crtk_servo_cp_example", ended, 0.04 * math.sqrt(2))


def test_crtk_servo_jp_example(rig: Rig) -> None:
    """A stream at 200 Hz, 10 degrees of yaw and pitch to both sides."""
    rig.homed()
    ended = rig.run("crtk_servo_jp_example", "PSM1")
    _, last = rig.plant.way()
    axes = np.array(rig.plant.axes)
    turned = np.degrees(np.arccos(np.clip(axes @ axes[0], -1.0, 1.0)).max())
    assert turned == pytest.approx(
        math.degrees(math.acos(math.cos(math.radians(10)) ** 2)), abs=0.5
    )
    assert last < FOUND_HOME
    rig.keep(
        "crtk_servo_jp_example", ended, f"shaft {turned:.1f}°, tip back to {1e3 * last:.2f} mm"
    )


def test_crtk_servo_cv_example(rig: Rig) -> None:
    """1 mm/s, said once: here a silent stream ends after 0.1 s, so the arm does not go on."""
    rig.homed()
    ended = rig.run("crtk_servo_cv_example", "PSM1")
    _, last = rig.plant.way()
    assert 2e-5 < last < 3e-4
    rig.keep("crtk_servo_cv_example", ended, f"tip {1e3 * last:.2f} mm, not 10: said once")


def test_crtk_xyz(rig: Rig) -> None:
    """10 mm along each axis, by keys."""
    rig.homed()
    ready = lambda: time.sleep(0.5)  # noqa: E731 (to read keys it sets its terminal up)
    asks = [("q  - quit", ready, "x"), *(("Waiting for key", ready, key) for key in "yzq")]
    ended = rig.run("crtk_xyz", "PSM1", steps=tuple(asks))
    far, last = rig.plant.way()
    away = np.array(rig.plant.tips) - rig.plant.tips[0]
    ways: list[Array] = []
    for end in away[np.linalg.norm(away, axis=1) > 0.0095] / 0.01:
        if all(end @ other < 0.9 for other in ways):
            ways.append(end)
    assert ended.waits == 6
    assert far == pytest.approx(0.01, abs=FOUND_HOME) and last < FOUND_HOME
    assert len(ways) == 3
    assert max(abs(ways[i] @ ways[j]) for i, j in ((0, 1), (0, 2), (1, 2))) < 0.05
    rig.keep("crtk_xyz", ended, f"tip {1e3 * far:.1f} mm along {len(ways)} axes")


def test_crtk_simple_orientation_registration(rig: Rig) -> None:
    """The arm is moved along x, y and z between the questions: the answer is the identity."""
    rig.homed()
    begun = rig.arm.get("setpoint_cp", 1.0, 1.0)

    def to(*offset: float) -> None:
        assert rig.arm.move_cp(shifted(begun, offset)).wait(timeout=20.0)
        time.sleep(0.3)

    steps: list[Step] = []
    for k, axis in enumerate("xyz"):
        there = [0.0, 0.0, 0.0]
        there[k] = 0.02
        steps.append((f"collect {axis}1", lambda: to(0.0, 0.0, 0.0), ENTER))
        steps.append((f"collect {axis}2", lambda there=there: to(*there), ENTER))  # type: ignore[misc]
    # In ROS 1 its last call, ral.shutdown(), raises by design of the client.
    ended = rig.run(
        "crtk_simple_orientation_registration",
        "-d",
        "PSM1",
        steps=steps,
        ends="ral.shutdown() has been called",
    )
    hand = float(ended.text.split("(x×y)·z = ")[1].split()[0])
    errors = [float(part.split()[0]) for part in ended.text.split("error to 90 = ")[1:]]
    assert hand == pytest.approx(1.0, abs=0.01) and max(errors) < 2.0
    rig.keep(
        "crtk_simple_orientation_registration",
        ended,
        f"handedness {hand:+.4f}, axes within {max(errors):.2f}° of 90",
    )


@pytest.mark.parametrize("place", [*page.CELLS, ROS2])
def test_crtk_teleop_example(ros_graph: RosGraph, rospy_node: str, place: str) -> None:
    """The endoscope's arm is the master: a tenth of its way, read at 500 Hz for ten seconds."""
    public_scripts.folder()
    side = interfaces.with_gateway(ros_graph) if place == page.ROS2 else ROS1
    two = "sim_two_arms_panda" if place == page.CELLS[1] else "sim_two_arms"
    shared: dict[str, object] = {"cell": paths.ROOT / "cells" / two, "mode": "freerun"}
    ros_graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    for name in ("PSM1", "ECM"):
        ros_graph.node("surg_control", "rcm_node", f"/{name}/controller", {**shared, "arm": name})
    plant, arms = Plant("PSM1"), {name: Arm(name, WallTime()) for name in ("PSM1", "ECM")}
    running = None
    try:
        for arm in arms.values():
            arm.check_connections(60.0)
            ros_graph.wait_for(lambda a=arm: a.enable(2.0) and a.home(2.0), 120.0, "home")
        note = partial(page.note, place=place, places=PLACES)
        rig = Rig(ros_graph, two, plant, arms["PSM1"], side, note)
        time.sleep(0.5)
        running = rig.begin("crtk_teleop_example", "ECM", "PSM1")
        driven = lambda: plant.cycle.command == Cycle.SERVO_CP or not running.running  # noqa: E731
        ros_graph.wait_for(driven, 60.0, "its stream")
        leader = arms["ECM"]
        goal = shifted(leader.get("setpoint_cp", 1.0, 1.0), (0.02, 0.0, 0.0))
        assert leader.move_cp(goal).wait(timeout=20.0)
        time.sleep(8.0)
        assert running.running, running.text
        last = plant.way()[1]
        ended = running.stop()
    finally:
        if running is not None:
            running.kill()
        for arm in arms.values():
            arm.close()
        plant.close()
    assert "unable to get" not in ended.text and "RuntimeWarning" not in ended.text, ended.text
    assert last == pytest.approx(0.002, abs=3e-4)
    assert not plant.faults and plant.pivot < PIVOT
    rig.keep("crtk_teleop_example", ended, f"tip {1e3 * last:.2f} mm for 20 mm of the master")


def test_dvrk_arm_test(rig: Rig) -> None:
    """Streams and moves of joints and poses; it ends in the middle, 120 mm deep."""
    rig.compat()
    ended = rig.run("dvrk_arm_test", "-a", "PSM1")
    assert "< move_cp complete" in ended.text
    middle = rig.plant.tips[-1]
    far, _ = rig.plant.way(middle)
    at_middle(rig)
    assert far > 0.05 - FOUND_HOME
    rig.keep("dvrk_arm_test", ended, f"tip {1e3 * far:.1f} mm from the middle")


def test_dvrk_psm_test(rig: Rig) -> None:
    """The jaw by moves and by a stream, beside moves of the arm."""
    rig.compat()
    steps = (("Enter to continue", None, ENTER),) * 7
    ended = rig.run("dvrk_psm_test", "-a", "PSM1", steps=steps)
    assert ended.text.count("moving back (3)") == 2, ended.text
    jaw = np.degrees([min(rig.plant.jaws), max(rig.plant.jaws)])
    at_middle(rig)
    assert jaw[1] - jaw[0] > 30.0
    rig.keep("dvrk_psm_test", ended, f"jaw from {jaw[0]:.0f}° to {jaw[1]:.0f}°")


def at_middle(rig: Rig) -> None:
    """All angles are zero, and the shaft is 120 mm deep: behind a wrist that is its centre."""
    time.sleep(0.3)
    wrist = surg_core.load_cell(paths.ROOT / "cells" / rig.cell).arms["PSM1"].instrument.wrist
    beyond = 0.0 if wrist is None else wrist.geometry.pitch_to_yaw + wrist.geometry.yaw_to_tip
    assert rig.plant.depth() == pytest.approx(0.12 + beyond, abs=FOUND_HOME)
    joints = np.array(rig.arm.get("measured_js", 1.0, 1.0).position)
    assert len(joints) == (4 if wrist is None else 6)
    assert joints[2] == pytest.approx(0.12, abs=6e-4)
    assert np.abs(np.delete(joints, 2)).max() < 0.012 and np.abs(joints[:2]).max() < 0.006


def test_dvrk_move_wait_test(rig: Rig) -> None:
    """10 degrees of yaw to both sides, waited for in two ways."""
    rig.compat()
    ended = rig.run("dvrk_move_wait_test", "-a", "PSM1")
    assert ended.text.count("Time for the full trajectory") == 2
    way = 2 * rig.plant.depth() * math.sin(math.radians(5))
    there_and_back(rig, "dvrk_move_wait_test", ended, way)


def taught(rig: Rig, bag: Path) -> Array:
    """Move every joint and the jaw there and back, into a bag; the largest turns of a wrist [rad].

    The bag holds the set-points of joints, poses and jaw, as the script wants them.
    """
    kinds = {"setpoint_js": JointState, "setpoint_cp": PoseStamped, "jaw/setpoint_js": JointState}
    heard = []
    ears = [
        rospy.Subscriber(f"/PSM1/{name}", kind, lambda m, name=name: heard.append((name, m)))
        for name, kind in kinds.items()
    ]
    begun = np.array(rig.arm.get("measured_js", 1.0, 1.0).position)
    rig.plant.begin()
    for way, jaw in ((1.0, 0.5), (0.0, 0.1)):
        closing = rig.arm.jaw.move_jp(jaw)
        assert rig.arm.move_jp(begun + way * TAUGHT[: len(begun)]).wait(timeout=20.0)
        assert closing.wait(timeout=20.0)
        time.sleep(0.5)  # a busy machine follows late
    for ear in ears:
        ear.unregister()
    with rosbag.Bag(str(bag), "w") as file:
        for name, message in sorted(heard, key=lambda each: each[1].header.stamp):
            file.write(f"/PSM1/{name}", message, message.header.stamp)
    return rig.plant.turns()


@pytest.mark.parametrize("mode", ["servo_jp", "servo_cp"])
def test_dvrk_bag_replay(rig: Rig, mode: str, tmp_path: Path) -> None:
    """What the arm did, jaw and all joints of a wrist included, once more by joints or by poses."""
    if rig.ros2:
        pytest.skip("the bag is one of ROS 1")
    rig.note = partial(page.note, place=rig.cell, places=(*page.CELLS, page.WRIST))
    rig.homed()
    bent, far = taught(rig, tmp_path / "taught.bag"), rig.plant.way()[0]
    words = ("-a", "PSM1", "-b", str(tmp_path / "taught.bag"), "-m", mode, "-j")
    steps = (('Press "Enter"', None, ENTER),) * (2 + (mode == "servo_cp"))
    row = f"dvrk_bag_replay: {mode}"
    ended = rig.run("dvrk_bag_replay", *words, steps=steps, ends="ral.shutdown() has been called")
    assert rig.plant.way() == pytest.approx((far, 0.0), abs=FOUND_HOME)
    assert np.ptp(rig.plant.jaws) == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(rig.plant.turns(), bent, atol=0.02)
    assert (bent > 0.3).all() and len(bent) == (2 if rig.cell == page.WRIST else 0)
    angles = ", ".join(f"{angle:.1f}°" for angle in np.degrees(bent))
    what = f", wrist {angles}" if angles else ""
    rig.keep(row, ended, f"tip {1e3 * far:.1f} mm away{what}")


def test_dvrk_system_test(rig: Rig) -> None:
    """Sounds are answered in words."""
    rig.compat()
    hung = partial(rig.note, "dvrk_system_test", 0)
    running = begun(rig.ros2, lambda: rig.begin("dvrk_system_test"), hung)
    try:
        ended = running.end()
    finally:
        running.kill()
    rig.good(ended)
    said = [text for text in rig.plant.words if "makes no sounds" in text]
    # With rclpy the first word may come before DDS knows the script.
    assert len(said) == 2 or (rig.ros2 and said), rig.plant.words
    assert rig.plant.way()[0] < 1e-4
    rig.keep("dvrk_system_test", ended, f"{len(said)} warnings, nothing moves")


@pytest.mark.parametrize("place", [*page.CELLS, ROS2])
def test_dvrk_console_test(tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scale of a running teleoperation follows."""
    public_scripts.folder()
    port, log, (python, more) = master.free_port(), tmp_path / "log", ROS1
    words = ["teleop", place, "--port", port, "--bind", f"127.0.0.1:{master.free_port()}"]
    if place == page.ROS2:
        python, more = interfaces.client(tmp_path)
        monkeypatch.setenv("ROS_DOMAIN_ID", more["ROS_DOMAIN_ID"])
        words[1:2] = [page.CELLS[0], "--ros2-commands"]
    with start(log, *words, "--out", tmp_path / "out") as process:
        try:
            end = time.monotonic() + 120.0
            while "Open http" not in log.read_text():
                assert process.poll() is None and time.monotonic() < end, log.read_text()
                time.sleep(0.2)
            env = {**environment(), "ROS_MASTER_URI": f"http://localhost:{port}"}
            words = ("-c", "console")
            begin = lambda: Script("dvrk_console_test", words, {**env, **more}, python)  # noqa: E731
            hung = partial(page.note, "dvrk_console_test", 0, place=place, places=PLACES)
            running = begun(place == page.ROS2, begin, hung)
            pause = lambda: time.sleep(1.0)  # noqa: E731
            running.talk([("press [enter]", pause, ENTER)] * 3)
            ended = running.end()
            running.kill()
        finally:
            process.send_signal(2)
            process.wait(60)
    assert ended.code == 0, ended.text
    is_now, expected = ended.text.rsplit("scale is ", 1)[1].split(", expected ")
    assert float(is_now) == pytest.approx(float(expected))
    page.note("dvrk_console_test", 0, f"scale {is_now}, as asked", place, PLACES)


def begun(ros2: bool, begin: Callable[[], Script], note: Callable[[str], None]) -> Script:
    """A script that has got beyond its configuration, with rclpy perhaps not the first one.

    There its client sleeps by a rate before anything spins: for ever, unless DDS knows all
    connections when it first looks. If it never does, that is noted, and the test skipped.
    """
    for _ in range(HUNG if ros2 else 1):
        running = begin()
        if not ros2 or goes_on(running):
            return running
        running.kill()
    why = f"hung {HUNG} times: its client sleeps by a rate before it spins"
    note(f"no: {why}")
    pytest.skip(why)


def goes_on(running: Script) -> bool:
    """Whether a script does more than configure itself."""
    assert wait_until(lambda: "configuring" in running.text, 60.0), running.text
    return wait_until(lambda: not re.fullmatch(r"configuring .*\n", running.text), STILL_S)


def refused(rig: Rig, script: str, *words: str, why: str, result: str) -> None:
    """A script that ends with an exception, for a reason, and moves nothing."""
    running = rig.begin(script, *words)
    try:
        ended = running.end()
    finally:
        running.kill()
    far, _ = rig.plant.way()
    assert ended.code != 0 and why in ended.text, ended.text
    assert far < 1e-4
    rig.note(script, ended.waits, f"no: {result}")


def test_crtk_haptic_example_commands_forces(rig: Rig) -> None:
    # In ROS 2 the client leaves `body` out.
    words, result = ("PSM1", "-b"), "nobody takes body/servo_cf"
    refused(rig, "crtk_haptic_example", *words, why="/servo_cf", result=result)


def test_crtk_rate_example(rig: Rig) -> None:
    """It times the client's own rate and speaks to no arm; an older text of it is for ROS 2."""
    if "rclpy" in public_scripts.path_of("crtk_rate_example").read_text("utf-8"):
        refused(rig, "crtk_rate_example", why="rclpy", result="imports rclpy")
        return
    ended = rig.begin("crtk_rate_example").end()
    assert ended.code == 0 and "Completed in" in ended.text, ended.text
    assert rig.plant.way()[0] < 1e-4
    rig.note("crtk_rate_example", 0, "speaks to no arm")


def test_dvrk_mtm_test_wants_a_master(rig: Rig) -> None:
    why, result = "/MTML/", "no arm is a master (MTML)"
    refused(rig, "dvrk_mtm_test", "-a", "MTML", why=why, result=result)


def test_dvrk_teleoperation_wants_a_master(rig: Rig) -> None:
    rig.compat()
    running = rig.begin("dvrk_teleoperation", "-m", "MTML", "-p", "PSM1")
    try:
        ended = running.end()
    finally:
        running.kill()
    # The word is that of the version.
    assert re.search("failed to (enable|home) MTML", ended.text), ended.text
    assert rig.plant.way()[0] < 1e-4
    rig.note("dvrk_teleoperation", 0, "no: no arm is a master (MTML)")


def test_dvrk_psm_effort_test_commands_forces(rig: Rig) -> None:
    """It homes and moves; the forces are answered in words, and the arm stays."""
    rig.compat()
    hung = partial(rig.note, "dvrk_psm_effort_test", 0)
    running = begun(rig.ros2, lambda: rig.begin("dvrk_psm_effort_test", "-a", "PSM1"), hung)
    ended = None
    try:
        running.talk([("press Enter", rig.plant.begin, ENTER)])
        running.talk([("press Enter", None, ENTER)] * 20, timeout=30.0)
        ended = running.end()
    finally:
        running.kill()
    said = {text.split(": ")[1].split()[0] for text in rig.plant.words if "ignored" in text}
    assert {"servo_jf", "jaw/servo_jf"} <= said, rig.plant.words
    assert "IndexError" in ended.text  # of the torques, which the arm does not measure
    assert rig.plant.way()[0] < 1e-4 and not rig.plant.faults
    rig.note("dvrk_psm_effort_test", ended.waits, "no: forces are answered in words")
