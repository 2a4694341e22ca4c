"""A policy that looks at the simulator's endoscope, at rest and in motion."""

from __future__ import annotations

import pytest

from helpers.graph.ros import RosGraph
from helpers.policy.policy_rig import PolicyRig
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths

CELL = paths.CELLS / "sim_two_arms"
POLICY = paths.ROOT / "tests" / "helpers" / "policy" / "looking_policy.py"


@pytest.mark.ros
@pytest.mark.full
def test_f08_a_scene_at_rest_is_no_frozen_camera(ros_graph: RosGraph, rospy_node: str) -> None:
    plan = SystemPlan(CELL, ("PSM1", "ECM"), False, ("left",), ros_graph.folder, record=False)

    def nodes(graph: RosGraph) -> None:
        for node in system.nodes(plan):
            words = {"arguments": node.arguments}
            graph.node(node.package, node.executable, node.name, node.params, **words)

    # A machine without a graphics card may draw few pictures a second.
    rig = PolicyRig(ros_graph, CELL, nodes, cameras=plan.streams, camera_rate=1.0)
    client = rig.policy("looking", script=POLICY)
    rig.wait_state("READY", timeout=120.0)
    rig.say("home")
    rig.enable.publish(True)

    def looked() -> bool:
        return "step 60" in client.log_tail(40)

    ros_graph.wait_for(looked, 40.0, f"pictures at rest and in motion ({rig.status})")
    assert "(480, 640, 3) uint8" in client.log_tail(40)
    assert rig.state == "RUNNING" and not rig.rejected
    print(client.log_tail(8), rig.status.obs_age_p50, rig.status.round_trip_p50)
    rig.close()
