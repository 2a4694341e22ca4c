"""The teleoperation node on the simulator and the controllers."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.graph import contract
from helpers.graph.ros import RosGraph
from helpers.teleop.moving_hand import MovingHand
from surg_cli.graph import master, system
from surg_cli.graph.processes import Child
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_core.held_endoscope import held_endoscope

pytestmark = pytest.mark.ros

TWO_ARMS = paths.ROOT / "cells" / "sim_two_arms"
PICTURE = "/test/image_raw"


class CrtkHand(MovingHand):
    """One that has pedals and hears what everybody says."""

    def __init__(self, teleop: Child) -> None:
        import rospy
        from sensor_msgs.msg import Joy
        from std_msgs.msg import Float64, String

        from surg_msgs.msg import Cycle, TeleopStatus

        super().__init__()
        self.teleop, self.cell = teleop, surg_core.load_cell(TWO_ARMS)
        self.cycles: dict[str, Cycle] = {}
        self.states: dict[str, str] = {}
        self.warnings: list[str] = []
        self.status: TeleopStatus | None = None
        self.scale = rospy.Publisher("/console/teleop/set_scale", Float64, queue_size=1)
        self.pedals = {
            name: rospy.Publisher(f"/console/{name}", Joy, queue_size=1)
            for name in ("clutch", "camera")
        }
        for arm in ("PSM1", "ECM"):
            self.inputs += [
                rospy.Subscriber(
                    f"/{arm}/cycle",
                    Cycle,
                    lambda m, a: self.cycles.__setitem__(a, m),
                    arm,
                    queue_size=1,
                ),
                rospy.Subscriber(
                    f"/hand_{arm}/current_state",
                    String,
                    lambda m, a: self.states.__setitem__(a, m.data),
                    arm,
                ),
            ]
        self.inputs += [
            rospy.Subscriber("/teleop/warning", String, lambda m: self.warnings.append(m.data)),
            rospy.Subscriber("/teleop/status", TeleopStatus, self._on_status),
        ]

    def _on_status(self, message: object) -> None:
        self.status = message

    def outputs(self) -> list[object]:
        return [*super().outputs(), self.scale, *self.pedals.values()]

    def connected(self) -> bool:
        """Whether everybody speaks and is heard."""
        said = len(self.cycles) == 2 and len(self.states) == 2 and self.status is not None
        return said and all(end.get_num_connections() for end in self.outputs())

    def press(self, pedal: str, down: bool) -> None:
        from sensor_msgs.msg import Joy

        self.pedals[pedal].publish(Joy(buttons=[int(down)]))

    def engaged(self, arm: str) -> bool:
        """Whether the arm follows. A starved machine may have let go: the operator acts again."""
        state = self.states[arm]
        let_go = state == "CLUTCHED" and bool(self.warnings) and "let go" in self.warnings[-1]
        if let_go or state in ("WAITING", "FAULT"):
            self.enable.publish(True)
            time.sleep(0.3)
        return self.states[arm] == "FOLLOWING"

    def move(self, graph: RosGraph, arm: str, axis: int) -> np.ndarray:
        """Moves along an axis of the view until the arm's tip is 2 mm further.

        Returns:
            Direction (3,) in which the tip went, in axes of the view at the end.
        """
        before = self.tip(arm)
        self.v = 0.02 * np.eye(3)[axis]

        def gone() -> bool:
            return self.engaged(arm) and bool(np.linalg.norm(self.tip(arm) - before) > 2e-3)

        graph.wait_for(gone, 20.0, f"{arm} to move")
        self.v = np.zeros(3)
        way = self.cell.arms[arm].X_WB[:3, :3] @ (self.tip(arm) - before)
        R_WV = held_endoscope(self.cell).rotation(np.array(self.cycles["ECM"].q))
        return R_WV.T @ way / np.linalg.norm(way)

    def tip(self, arm: str) -> np.ndarray:
        return np.array(self.cycles[arm].p_tip)

    def falls_silent(self, graph: RosGraph) -> float:
        """Says nothing more while the instrument moves; returns how long this was not noticed [s].

        A starved machine may have taken the arm's link away just then: the hand does it again.
        """
        left = ("WAITING", "FAULT")
        for _ in range(3):
            graph.wait_for(lambda: self.engaged("PSM1"), 10.0, "the instrument to follow")
            self.v = np.array([0.02, 0.0, 0.0])
            time.sleep(0.2)
            self.speaks.clear()
            silent = time.monotonic()
            graph.wait_for(lambda: self.states["PSM1"] in left, 5.0, "the silence to be noticed")
            if self.states["PSM1"] == "WAITING":
                return time.monotonic() - silent
            assert any("FAULT (link)" in text for text in self.warnings[-3:]), self.warnings
            self.v = np.zeros(3)
            self.speaks.set()
        raise AssertionError(f"three times the link was lost first: {self.warnings}")

    def rests(self, arm: str, seconds: float = 0.3) -> bool:
        """Whether the arm's set-point stands still for a while."""
        before = np.array(self.cycles[arm].p_set)
        time.sleep(seconds)
        return bool(np.linalg.norm(np.array(self.cycles[arm].p_set) - before) < 1e-5)


@pytest.fixture
def hand(ros_graph: RosGraph, rospy_node: str) -> Iterator[CrtkHand]:
    plan = SystemPlan(TWO_ARMS, ("PSM1", "ECM"), False, (), ros_graph.folder, record=False)
    for node in system.nodes(plan):
        words = {"arguments": node.arguments}
        ros_graph.node(node.package, node.executable, node.name, node.params, **words)
    params = {
        "cell": TWO_ARMS,
        "leader": "crtk",
        "settings": {"name": "hand"},
        "scale": 0.5,
        "picture": PICTURE,
    }
    child = ros_graph.node("surg_teleop", "teleop_node", "/teleop", params)
    found = CrtkHand(child)
    yield found
    found.close()


def test_a_crtk_leader_drives_both_arms_in_free_run(ros_graph: RosGraph, hand: CrtkHand) -> None:
    """Enable, follow, camera pedal, another sender (F26), silence (F03), disable (F30), the end.

    Before that: the topics are those of docs/reference/topics.yaml, and a frozen picture is said
    (F08).
    """
    import rospy
    from geometry_msgs.msg import PoseStamped

    wait = ros_graph.wait_for
    wait(hand.connected, 40.0, "both arms and the teleoperation")
    assert hand.states == {"PSM1": "DISABLED", "ECM": "DISABLED"}
    others = ("/PSM1/", "/ECM/", "/record/", "/sim/", "/endoscope/drift", PICTURE)
    arms = ("PSM1", "ECM")
    assert contract.found(ros_graph, "/teleop", others) == contract.promised("teleop", "hand", arms)
    freeze_the_picture(ros_graph, hand)
    select_as_a_dvrk_console_does(ros_graph, hand)
    hand.enable.publish(True)
    wait(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow")
    wait(lambda: hand.states["ECM"] == "CLUTCHED", 10.0, "the endoscope to be clutched")
    wait(lambda: hand.cycles["PSM1"].source == "/teleop", 5.0, "the hand to hold the arm")

    scope = hand.tip("ECM")
    assert hand.move(ros_graph, "PSM1", 0) == pytest.approx([1.0, 0.0, 0.0], abs=0.1)
    assert np.linalg.norm(hand.tip("ECM") - scope) < 2e-4

    hand.press("camera", True)
    wait(lambda: hand.engaged("ECM"), 10.0, "the endoscope to follow")
    wait(lambda: hand.states["PSM1"] != "FOLLOWING", 1.0, "the instrument to be clutched")
    wait(lambda: hand.rests("PSM1"), 5.0, "the instrument to rest")
    before = np.array(hand.cycles["PSM1"].p_set)
    assert hand.move(ros_graph, "ECM", 1)[1] > 0.9
    assert np.linalg.norm(np.array(hand.cycles["PSM1"].p_set) - before) < 1e-5
    hand.press("camera", False)
    wait(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow again")

    # F26: a stranger's poses are refused and the hand goes on.
    stranger = rospy.Publisher("/PSM1/servo_cp", PoseStamped, queue_size=1)
    wait(lambda: stranger.get_num_connections() > 0, 5.0, "the stranger's connection")
    refused = hand.cycles["PSM1"].refused
    pose = PoseStamped()
    pose.pose.position.z, pose.pose.orientation.w = 0.12, 1.0

    def refuses() -> bool:
        if hand.engaged("PSM1") and hand.cycles["PSM1"].source == "/teleop":
            stranger.publish(pose)
        return hand.cycles["PSM1"].refused >= refused + 10

    wait(refuses, 20.0, "the stranger to be refused")
    assert hand.cycles["PSM1"].source in ("", "/teleop")  # free only where it was just let go
    stranger.unregister()
    wait(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow on")

    # F03: silence while moving.
    noticed = hand.falls_silent(ros_graph)
    wait(lambda: hand.rests("PSM1"), 5.0, "the arm to rest")
    assert any("hand is silent" in text for text in hand.warnings), hand.warnings
    hand.speaks.set()
    assert hand.rests("PSM1", 0.5)
    assert hand.states["PSM1"] == "WAITING"
    hand.v = np.zeros(3)
    print(f"silence of the leader noticed after {1e3 * noticed:.0f} ms")

    kill_the_pedals(ros_graph, hand)

    hand.scale.publish(7.0)
    wait(lambda: any("scale 7 is refused" in t for t in hand.warnings), 5.0, "the refused scale")
    hand.enable.publish(True)
    wait(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow again")
    hand.enable.publish(False)
    wait(lambda: hand.cycles["PSM1"].state == 2, 5.0, "PAUSED")
    wait(lambda: hand.cycles["PSM1"].source == "", 5.0, "the arm to be free")

    # The node is ended while the hand moves.
    hand.enable.publish(True)
    wait(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow again")
    hand.v = np.array([-0.02, 0.0, 0.0])
    time.sleep(0.2)
    hand.teleop.process.terminate()
    wait(lambda: hand.cycles["PSM1"].state == 2, 5.0, "PAUSED by a node that ends")
    assert hand.teleop.process.wait(10) == 0


def select_as_a_dvrk_console_does(graph: RosGraph, hand: CrtkHand) -> None:
    """The console's pairs: each stated to who comes late; an unselected one is not enabled."""
    import rospy
    from std_msgs.msg import Float64, String

    scales: list[float] = []
    pairs: dict[str, list[str]] = {"selected": [], "unselected": []}
    ends: list[Any] = [
        rospy.Subscriber("/console/teleop/scale", Float64, lambda m: scales.append(m.data)),
        *(
            rospy.Subscriber(f"/console/teleop/{name}", String, lambda m, to: to.append(m.data), to)
            for name, to in pairs.items()
        ),
    ]
    words = {
        name: rospy.Publisher(f"/console/teleop/{name}", String, queue_size=2)
        for name in ("select", "unselect")
    }
    ends += words.values()
    graph.wait_for(lambda: all(e.get_num_connections() for e in ends), 10.0, "the connections")
    graph.wait_for(lambda: len(pairs["selected"]) >= 2, 5.0, "the pairs")
    assert sorted(set(pairs["selected"])) == ["hand_ECM", "hand_PSM1"]
    graph.wait_for(lambda: scales == [0.5], 5.0, "the scale")
    words["unselect"].publish("hand_PSM1")
    graph.wait_for(lambda: pairs["unselected"] == ["hand_PSM1"], 5.0, "the unselected pair")
    hand.enable.publish(True)
    graph.wait_for(lambda: hand.states["ECM"] == "CLUTCHED", 10.0, "the other pair")
    assert hand.states["PSM1"] == "DISABLED"
    words["select"].publish("hand_nobody")
    graph.wait_for(lambda: any("hand_nobody" in t for t in hand.warnings), 5.0, "the refusal")
    words["select"].publish("hand_PSM1")
    graph.wait_for(lambda: pairs["selected"][-1] == "hand_PSM1", 5.0, "the selected pair")
    assert hand.states["PSM1"] == "DISABLED"
    for end in ends:
        end.unregister()


def freeze_the_picture(graph: RosGraph, hand: CrtkHand) -> None:
    """F08: half a second of living pictures, then the same one again and again."""
    import rospy
    from sensor_msgs.msg import Image

    camera = rospy.Publisher(PICTURE, Image, queue_size=1)
    graph.wait_for(lambda: camera.get_num_connections() > 0, 5.0, "the picture's connection")
    image = Image(height=8, width=8, encoding="rgb8", step=24)
    image.header.frame_id = "endoscope_left"
    for k in range(10):
        image.header.stamp = rospy.Time.now()
        image.data = bytes([k]) * 192
        camera.publish(image)
        time.sleep(0.05)

    def told() -> bool:
        image.header.stamp = rospy.Time.now()
        camera.publish(image)
        time.sleep(0.03)
        return any("repeats the same picture" in text for text in hand.warnings)

    graph.wait_for(told, 5.0, "the frozen picture to be said")
    camera.unregister()


def kill_the_pedals(graph: RosGraph, hand: CrtkHand) -> None:
    """F03: a pedal node that is killed with its clutch up is noticed, and gone on without."""
    hand.enable.publish(True)
    graph.wait_for(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow again")
    script = paths.ROOT / "tests" / "helpers" / "teleop" / "pedal_publisher.py"
    argv = [sys.executable, "-s", str(script)]
    feet = graph.supervisor.start("/feet", argv)
    topic = "/footpedals/clutch"
    graph.wait_for(lambda: topic in master.publications(graph.uri), 20.0, "the pedals")
    time.sleep(1.0)  # six repetitions make it a source that lives by them
    graph.wait_for(lambda: hand.engaged("PSM1"), 10.0, "the instrument to follow on")
    feet.process.kill()
    killed = time.monotonic()
    graph.wait_for(lambda: hand.states["PSM1"] == "WAITING", 5.0, "the silence of the pedals")
    print(f"killed pedals noticed after {1e3 * (time.monotonic() - killed):.0f} ms")
    graph.wait_for(
        lambda: any("the buttons of /feet (/footpedals) are silent" in t for t in hand.warnings),
        5.0,
        "the warning",
    )
    assert hand.rests("PSM1")
    assert hand.states["PSM1"] == "WAITING"
