"""A wall at the tip is felt by the hand: simulator, controller, teleoperation, Lambda.7's stub."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.graph.ros import RosGraph
from helpers.teleop import lambda7
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths

pytestmark = pytest.mark.ros

CELL = paths.ROOT / "cells" / "sim_ur5e"
TASK = paths.ROOT / "tests" / "helpers" / "sim" / "walled_task.py"
VIEW = [0.907, 0.0, 0.0, 0.421]
SCALE = 2.0
CYCLES = 55
"""Of the device, 1 ms or longer each."""


def test_a_wall_is_felt_and_a_clutch_and_an_end_are_not(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    import rospy
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import Joy
    from std_msgs.msg import Bool, String

    graph, wait = ros_graph, ros_graph.wait_for
    plan = SystemPlan(
        CELL, ("PSM1",), False, (), tmp_path, record=False, task=str(TASK), setting="phantom"
    )
    for node in system.nodes(plan):
        graph.node(node.package, node.executable, node.name, node.params, arguments=node.arguments)
    library = lambda7.build(tmp_path)
    state = lambda7.share(graph.folder / "state")
    where = {"FORCEDIM_LIBRARY": str(library), "LAMBDA7_STUB": str(graph.folder / "state")}
    params = {"name": "MTMR", "haptics": True, "haptic_scale": SCALE}
    graph.node("surg_lambda7", "lambda7_node", "/lambda7", params, env=where)
    teleop = graph.node(
        "surg_teleop",
        "teleop_node",
        "/teleop",
        {
            "cell": CELL,
            "leader": "crtk",
            "settings": {"name": "MTMR"},
            "scale": 0.5,
            "view": VIEW,
            "picture": "",
            "haptics": True,
        },
    )
    states: list[str] = [""]
    tip: list[np.ndarray] = []

    def on_force(message: Any) -> None:
        f = message.wrench.force
        tip.append(np.array([f.x, f.y, f.z]))

    ends: list[Any] = [
        rospy.Subscriber("/MTMR_PSM1/current_state", String, lambda m: states.append(m.data)),
        rospy.Subscriber("/PSM1/tool/measured_cf", WrenchStamped, on_force),
    ]
    enable = rospy.Publisher("/console/teleop/enable", Bool, queue_size=1)
    clutch = rospy.Publisher("/console/clutch", Joy, queue_size=1)
    ends += [enable, clutch]
    wait(lambda: all(end.get_num_connections() for end in ends), 40.0, "everybody")

    def follows() -> bool:
        if states[-1] != "FOLLOWING":
            enable.publish(True)
            time.sleep(0.3)
        return states[-1] == "FOLLOWING"

    wait(follows, 20.0, "the arm to follow")
    assert state.nonzero_forces == 0, "there is room before the wall"

    def pushed() -> bool:
        """Goes on to the right, which is y of the device and x of view and world."""
        if follows() and np.linalg.norm(tip[-1]) < 0.8:
            state.p[1] += 2e-4
            time.sleep(0.02)
        return bool(np.linalg.norm(tip[-1]) >= 0.8)

    def felt() -> np.ndarray:
        return np.array(state.force[:3])

    wait(pushed, 30.0, "the wall")
    R_WB = surg_core.load_cell(CELL).arms["PSM1"].X_WB[:3, :3]
    R_VW = surg_core.quaternion_xyzw_to_matrix(VIEW).T
    R_VM = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])

    def expected() -> np.ndarray:
        return SCALE * R_VM.T @ R_VW @ R_WB @ tip[-1]

    wait(lambda: bool(np.abs(felt() - expected()).max() < 0.1), 10.0, "all of its force")
    assert felt()[1] == pytest.approx(-SCALE * np.linalg.norm(tip[-1]), abs=0.12)
    print(f"at the tip {np.linalg.norm(tip[-1]):.2f} N, on the hand {felt().round(2)} N")

    clutch.publish(Joy(buttons=[1]))
    wait(lambda: states[-1] == "CLUTCHED", 5.0, "the clutch")
    begin = state.forces
    wait(lambda: not felt().any() or state.forces > begin + CYCLES, 5.0, "the end")
    assert not felt().any()
    clutch.publish(Joy(buttons=[0]))
    wait(lambda: follows() and abs(felt()[1]) > 0.5, 20.0, "the force again")

    begin = state.forces
    teleop.process.kill()
    wait(lambda: not felt().any() or state.forces > begin + 2 * CYCLES, 5.0, "the silence")
    cycles = state.forces - begin
    print(f"no force {cycles} cycles after the teleoperation was killed")
    assert not felt().any() and cycles <= CYCLES
    for end in ends:
        end.unregister()
