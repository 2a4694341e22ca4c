"""A policy that is killed in the middle of an episode and started again completes it (F04)."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.policy.policy_rig import CELL, PolicyRig
from helpers.results.policy_results import note
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths

HELPERS = paths.ROOT / "tests" / "helpers" / "sim"
GOAL = paths.ROOT / "tests" / "helpers" / "policy" / "goal_policy.py"


@pytest.mark.ros
@pytest.mark.full
def test_f04_a_restart_within_the_episode_recovers_and_completes(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    plan = SystemPlan(
        CELL,
        ("PSM1",),
        False,
        (),
        tmp_path,
        record=False,
        task=str(HELPERS / "patient_task.py"),
        setting="phantom",
        seed=3,
    )

    def nodes(graph: RosGraph) -> None:
        for node in system.nodes(plan):
            words = {"arguments": node.arguments}
            graph.node(node.package, node.executable, node.name, node.params, **words)

    rig = PolicyRig(
        ros_graph, CELL, nodes, task="patient", privileged=True, autostart=True, instruction="go"
    )
    first = rig.policy("first", script=GOAL)
    begin = rig.now.p_tip
    ros_graph.wait_for(
        lambda: bool(np.linalg.norm(rig.now.p_tip - begin) > 0.008), 30.0, "the arm to be under way"
    )
    first.send(signal.SIGKILL)
    moment = time.monotonic()
    took = rig.standstill_after(moment)
    rig.wait_state("IDLE")
    left = rig.now.p_tip
    assert rig.status.episode == 1

    second = rig.policy("second", script=GOAL)
    ros_graph.wait_for(
        lambda: "episode 1: success" in second.log_tail(20), 40.0, "the episode to be completed"
    )
    assert "resumed" in second.log_tail(20) and rig.status.episode == 1
    assert rig.status.sessions == 2
    way = float(np.linalg.norm(rig.now.p_tip - left))
    note(
        7,
        1,
        f"standstill after {1e3 * took:.0f} ms; the second process led the last {1e3 * way:.0f} mm "
        "and the task was solved",
    )
    assert way > 0.005
    rig.close()
