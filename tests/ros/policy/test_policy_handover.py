"""Operator, policy, operator: the teleoperation node and the model server on one arm (F30)."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
import rospy

from helpers.graph.ros import RosGraph
from helpers.policy.policy_rig import CELL, PolicyRig
from helpers.results.policy_results import note
from helpers.teleop.moving_hand import MovingHand
from surg_core.status_check import value_name
from surg_msgs.msg import TeleopStatus

pytestmark = [pytest.mark.ros, pytest.mark.full]

VIEW = [0.907, 0.0, 0.0, 0.421]  # any: an endoscope that nobody holds


class Hand(MovingHand):
    """The operator's, which knows whether the arm follows."""

    def __init__(self) -> None:
        super().__init__()
        self.state = ""
        self.inputs.append(rospy.Subscriber("/teleop/status", TeleopStatus, self._on_status))

    def _on_status(self, message: TeleopStatus) -> None:
        (hand,) = message.hands
        self.state = value_name(hand, "state")


@pytest.fixture
def hand(ros_graph: RosGraph, rospy_node: str) -> Iterator[Hand]:
    """The operator's."""
    params = {
        "cell": CELL,
        "leader": "crtk",
        "settings": {"name": "hand"},
        "scale": 1.0,
        "view": VIEW,
        "picture": "",
    }
    ros_graph.node("surg_teleop", "teleop_node", "/teleop", params)
    made = Hand()
    yield made
    made.close()


def test_f30_operator_policy_operator_without_a_jump(ros_graph: RosGraph, hand: Hand) -> None:
    rig = PolicyRig(ros_graph, need_teleop=True)
    rig.policy("circle")
    ros_graph.wait_for(lambda: hand.state == "DISABLED", 20.0, "the teleoperation")
    rig.wait_state("READY")
    begin = len(rig.cycles)
    _lead(ros_graph, rig, hand)

    # While the operator has the arm, the policy does not get it.
    rig.enable.publish(True)
    ros_graph.wait_for(lambda: "operator" in rig.status.refused, 5.0, "the refusal")
    assert rig.now.source == "/teleop"
    hand.enable.publish(False)
    ros_graph.wait_for(lambda: hand.state == "DISABLED", 5.0, "the operator to let go")
    rig.run()
    assert rig.now.source == "/policy"
    assert not rig.rejected

    # One press: the policy lets go in mid-motion, and the hand has the arm.
    moment = time.monotonic()
    _lead(ros_graph, rig, hand)
    assert (rig.state, rig.reason) == ("PAUSED", "OPERATOR")
    states = {(seen.state, seen.source) for seen in rig.cycles if seen.at > moment}
    assert (2, "") in states, "through PAUSED, in nobody's hands"
    hand.enable.publish(False)
    ros_graph.wait_for(lambda: hand.state == "DISABLED", 5.0, "the operator to let go")
    step = rig.largest_step(begin)
    note(6, len(rig.cycles) - begin, f"{1e6 * step:.0f} um")
    # 0.25 m/s are 0.5 mm in a cycle; this process may have missed one.
    assert step < 1e-3
    rig.close()


def _lead(graph: RosGraph, rig: PolicyRig, hand: Hand) -> None:
    """The operator enables and moves the arm by 5 mm."""
    asked = 0.0

    def follows() -> bool:
        nonlocal asked
        if hand.state != "FOLLOWING" and time.monotonic() - asked > 3.0:
            asked = time.monotonic()  # a starved machine may have let go: the operator acts again
            hand.enable.publish(True)
        return hand.state == "FOLLOWING"

    graph.wait_for(follows, 20.0, f"the arm to follow the hand ({rig.status})")
    before = rig.now.p_tip
    hand.v = np.array([0.02, 0.0, 0.0])
    graph.wait_for(
        lambda: follows() and bool(np.linalg.norm(rig.now.p_tip - before) > 5e-3),
        20.0,
        "the arm to move",
    )
    hand.v = np.zeros(3)
