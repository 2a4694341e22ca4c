"""What a running policy plans and sees arrives on a topic, from a process that speaks the wire."""

from __future__ import annotations

import numpy as np
import pytest
import rospy

from helpers.graph.ros import RosGraph
from helpers.policy.policy_rig import PolicyRig
from surg_cli.host import paths
from surg_msgs.msg import PolicyPlan

POLICY = paths.ROOT / "tests" / "helpers" / "policy" / "telling_policy.py"


@pytest.mark.ros
@pytest.mark.full
def test_plan_and_sight_arrive_and_a_wrong_word_stops_nothing(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    rig = PolicyRig(ros_graph)
    heard: list[PolicyPlan] = []
    ear = rospy.Subscriber("/policy/plan", PolicyPlan, heard.append, tcp_nodelay=True)
    rig.policy("telling", script=POLICY)
    rig.wait_state("READY")
    rig.run()
    ros_graph.wait_for(lambda: len(heard) > 60, 20.0, "plans")
    accepted = rig.status.accepted
    ear.unregister()
    plans = heard[:]

    # At most one for each observation: 20 Hz, and in order.
    assert np.all(np.diff([plan.seq for plan in plans]) >= 1)
    names = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
    said = [plan for plan in plans if plan.phase]
    assert {plan.phase for plan in said} == {"round"} and len(said) > 40
    for plan in plans:
        assert list(plan.names) == names and len(plan.values) == 5 * plan.rows
        assert plan.rejected == 0 and plan.rule == "" and plan.period == 0.05
    for plan in said:
        step = round(100 * plan.x[0])
        assert list(plan.keypoints) == ["tip"] and (plan.y[0], plan.certainty[0]) == (0.25, 0.5)
        assert (plan.map_rows, plan.map_columns, len(plan.attention)) == (2, 3, 6)
        assert step % 10, "the wrong ones were dropped"
        assert plan.picture.endswith("left") and plan.confidence == 0.75
    # Every tenth says something wrong: its plan is there all the same.
    assert len(plans) > len(said)
    assert all(plan.rows and not plan.keypoints for plan in plans if not plan.phase)

    # The rows are where the arm then goes: a later set-point lies on the planned way.
    plan = plans[len(plans) // 2]
    rows = np.array(plan.values).reshape(plan.rows, 5)
    speed = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1) / plan.period
    assert speed == pytest.approx(0.05, rel=0.05)
    told = {action.step: action.values[:3] for action in rig.actions}
    for step, row in zip(range(plan.step, plan.step + plan.rows), rows, strict=True):
        if step in told:
            np.testing.assert_allclose(row[:3], told[step], atol=2e-6)
    assert plan.step in told

    malformed = dict(zip(rig.status.malformed_codes, rig.status.malformed, strict=True))
    assert malformed.get("seen", 0) >= 4 and rig.state == "RUNNING" and accepted > 40
    lines = rig.server.log_tail(200).count("not shown")
    assert lines == 1, "one warning"
    rig.close()
