"""Two hands in one episode: the robot's instrument, and the assistant's that has no controller."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.graph.ros import RosGraph
from helpers.sim.assistant_pose import forward
from surg_cli.graph import operator_nodes, system
from surg_cli.graph.processes import Child
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import cells, paths
from surg_core.status_check import value_name

pytestmark = pytest.mark.ros

CELL = paths.CELLS / "sim_ur5e"
HANDS = {"first": "PSM1", "second": "assistant"}


class Pair:
    """Two CRTK leaders, each a velocity in the picture that is published 50 times a second."""

    def __init__(self, R_WA: np.ndarray, R_WV: np.ndarray) -> None:
        import rospy
        from geometry_msgs.msg import TwistStamped
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Bool, String

        from surg_msgs.msg import Cycle, TeleopStatus

        self._R_VA, self._R_VW = R_WV.T @ R_WA, R_WV.T
        self._R_WB = cells.load(CELL).arms["PSM1"].X_WB[:3, :3]
        self.v = {name: np.zeros(3) for name in HANDS}
        self.grip = dict.fromkeys(HANDS, 0.0)
        self.speaks = dict.fromkeys(HANDS, True)
        self.status: dict[str, str] = {}
        self.warnings: list[str] = []
        self.joints, self.jaw, self.cycle = np.zeros(0), 0.0, None
        self._stop = threading.Event()
        keys = {"queue_size": 1, "tcp_nodelay": True}
        self._rates = {
            name: rospy.Publisher(f"/{name}/measured_cv", TwistStamped, **keys) for name in HANDS
        }
        self._grips = {
            name: rospy.Publisher(f"/{name}/gripper/measured_js", JointState, **keys)
            for name in HANDS
        }
        self.enable = rospy.Publisher("/console/teleop/enable", Bool, **keys)
        self._inputs = [
            rospy.Subscriber("/assistant/measured_js", JointState, self._on_joints, **keys),
            rospy.Subscriber("/assistant/jaw/measured_js", JointState, self._on_jaw, **keys),
            rospy.Subscriber("/PSM1/cycle", Cycle, lambda m: setattr(self, "cycle", m), **keys),
            rospy.Subscriber("/teleop/status", TeleopStatus, self._on_status),
            rospy.Subscriber("/teleop/warning", String, lambda m: self.warnings.append(m.data)),
        ]
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _on_joints(self, message: object) -> None:
        self.joints = np.array(message.position)

    def _on_jaw(self, message: object) -> None:
        self.jaw = float(message.position[0])

    def _on_status(self, message: object) -> None:
        self.status = {hand.arm: value_name(hand, "state") for hand in message.hands}

    def _run(self) -> None:
        import rospy
        from geometry_msgs.msg import TwistStamped
        from sensor_msgs.msg import JointState

        while not self._stop.wait(0.02):
            for name in HANDS:
                if not self.speaks[name]:
                    continue
                twist = TwistStamped()
                twist.header.stamp = rospy.Time.now()
                v = twist.twist.linear
                v.x, v.y, v.z = self.v[name].tolist()
                self._rates[name].publish(twist)
                self._grips[name].publish(JointState(name=["gripper"], position=[self.grip[name]]))

    def connected(self) -> bool:
        """Whether everybody speaks and is heard."""
        ends = (*self._rates.values(), *self._grips.values(), self.enable)
        said = (
            self.cycle is not None and self.joints.size and set(self.status) >= set(HANDS.values())
        )
        return bool(said) and all(end.get_num_connections() for end in ends)

    def follows(self, arm: str) -> bool:
        """Whether the arm follows. A starved machine may have let go: the operator acts again."""
        if self.status[arm] in ("DISABLED", "WAITING", "FAULT"):
            self.v = {name: np.zeros(3) for name in HANDS}  # a stick that is pushed engages nothing
            self.enable.publish(True)
            time.sleep(0.3)
        return self.status[arm] == "FOLLOWING"

    def tip(self, arm: str) -> np.ndarray:
        """(3,) tip of an arm in the axes of the picture [m]."""
        if arm == "assistant":
            return self._R_VA @ forward(self.joints)[:3, 3]
        assert self.cycle is not None
        return self._R_VW @ self._R_WB @ np.array(self.cycle.p_tip)

    def rests(self) -> bool:
        """Whether the assistant's servos are where they were told to be: in the time they need."""
        before = self.joints
        time.sleep(0.2)
        return bool(np.abs(self.joints - before).max() < 1e-5)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        for end in (*self._inputs, *self._rates.values(), *self._grips.values(), self.enable):
            end.unregister()


@pytest.fixture
def teleop(ros_graph: RosGraph, rospy_node: str) -> Iterator[tuple[Pair, Child]]:
    plan = SystemPlan(CELL, ("PSM1",), False, (), ros_graph.folder, record=False, task="bgr")
    for node in system.nodes(plan):
        params = {**node.params, "endless": True} if node.name == "/sim" else node.params
        ros_graph.node(node.package, node.executable, node.name, params, arguments=node.arguments)
    node = operator_nodes.teleoperation(plan, "crtk", page=False, second="crtk")
    params = {
        **node.params,
        "settings": {"name": "first"},
        "second_settings": {"name": "second"},
        "mapping": "rate",
        "second_mapping": "rate",
    }
    child = ros_graph.node(node.package, node.executable, node.name, params)
    R_WA = Rotation.from_quat(params["assistant_frame"]).as_matrix()
    pair = Pair(R_WA, Rotation.from_quat(params["view"]).as_matrix())
    yield pair, child
    pair.close()


def test_two_hands_move_two_instruments_as_the_picture_shows_it(
    ros_graph: RosGraph, teleop: tuple[Pair, Child]
) -> None:
    pair, child = teleop
    wait = ros_graph.wait_for
    wait(pair.connected, 40.0, "simulator, controller and teleoperation")
    for arm in HANDS.values():
        wait(lambda arm=arm: pair.follows(arm), 20.0, f"{arm} to follow")

    # Both at once, each along another axis of the picture. Roughly: a starved machine lets go again
    # and again, and the assistant's servos then stop on the way, each at a place of its own. Exact
    # is `test_the_second_hand_moves_its_tip_as_the_picture_shows_it` (test_cli_teleop.py).
    axes = {"first": np.array([1.0, 0.0, 0.0]), "second": np.array([0.0, -1.0, 0.0])}
    before = {arm: pair.tip(arm) for arm in HANDS.values()}

    def gone() -> bool:
        for name, arm in HANDS.items():
            if pair.follows(arm):
                pair.v[name] = 0.02 * axes[name]
        return all(np.linalg.norm(pair.tip(arm) - before[arm]) > 3e-3 for arm in before)

    wait(gone, 40.0, "both tips to move")
    for name, arm in HANDS.items():
        way = pair.tip(arm) - before[arm]
        assert way @ axes[name] > 0.8 * np.linalg.norm(way), (name, way)
    pair.v = {name: np.zeros(3) for name in HANDS}
    # The assistant's jaw follows the second hand's grip, and nobody else's.

    def opens() -> bool:
        # A jaw never opens by itself: a hand that was let go on the way closes and opens again.
        if pair.status["assistant"] != "FOLLOWING":
            pair.grip["second"] = 0.0
            time.sleep(0.1)
        if pair.follows("assistant"):
            pair.grip["second"] = 0.6
        return pair.jaw > 0.1

    wait(opens, 20.0, "the assistant's jaw to open")
    assert pair.cycle.jaw_set < 0.05

    # F03: the second hand falls silent while it moves. Its instrument rests, the other goes on.
    wait(lambda: pair.follows("assistant"), 20.0, "the assistant to follow")
    pair.v["second"] = 0.02 * axes["second"]
    time.sleep(0.3)
    pair.speaks["second"] = False
    silent = time.monotonic()
    wait(lambda: pair.status["assistant"] == "WAITING", 5.0, "the silence to be noticed")
    print(f"silence of the second hand noticed after {1e3 * (time.monotonic() - silent):.0f} ms")
    said = "second on assistant: second is silent"  # on a topic of its own, so it may come later
    wait(lambda: any(said in text for text in pair.warnings), 5.0, "its warning")
    wait(pair.rests, 20.0, "the assistant's instrument to rest")
    rest, first = pair.joints, pair.tip("PSM1")

    def goes_on() -> bool:
        if pair.status["PSM1"] == "FOLLOWING":
            pair.v["first"] = 0.02 * axes["first"]
        return bool(np.linalg.norm(pair.tip("PSM1") - first) > 2e-3)

    wait(goes_on, 20.0, "the first hand to go on")
    pair.speaks["second"] = True
    time.sleep(0.3)
    assert np.abs(pair.joints - rest).max() < 2e-4, "nothing goes on by itself"

    # The end: the robot is paused, the assistant's instrument stays where it is.
    child.process.terminate()
    wait(lambda: pair.cycle.state == 2, 5.0, "PAUSED by a node that ends")
    assert child.process.wait(10) == 0
    time.sleep(0.3)
    assert np.abs(pair.joints - rest).max() < 2e-4
