"""A hand turns a wristed instrument through the whole graph; the simulator's joints say how far."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.graph.ros import RosGraph
from helpers.teleop.moving_hand import MovingHand
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_sim.physics.sim_arm import robot_part
from surg_sim.physics.world import World

pytestmark = pytest.mark.ros

CELL = paths.ROOT / "cells" / "sim_ur5e_wrist"
ARM = "PSM1"
VIEW = [0.907, 0.0, 0.0, 0.421]
TURN = np.radians(20.0)
OFF = np.radians(1.0)
"""[rad] by which an arm at rest may be turned otherwise than the hand."""
TRIES = 5
"""Of a turn, on a machine that may be starved."""
STILL = 3e-4
"""[m] that a tip may move while it is turned and the hand stays."""


class Mujoco:
    """The pose of the true tip in the world, by MuJoCo, from the joints that the simulator states.

    Attributes:
        q: Newest position of each joint [rad], by its name in the scene.
    """

    def __init__(self) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        cell = surg_core.load_cell(CELL)
        self._arm, self._world = cell.arms[ARM], World(cell, visuals=False)
        self.q: dict[str, float] = {}
        self.ends = [
            rospy.Subscriber(f"/{ARM}/robot/measured_js", JointState, self._on_robot),
            rospy.Subscriber(f"/{ARM}/tool/measured_js", JointState, self._on_tool),
        ]

    def _on_robot(self, message: Any) -> None:
        names = (robot_part(self._arm, name) for name in self._arm.robot.joint_names)
        self.q |= dict(zip(names, message.position, strict=True))

    def _on_tool(self, message: Any) -> None:
        said = dict(zip(message.name, message.position, strict=True))
        self.q |= {f"{ARM}_wrist_{name}": said[name] for name in ("pitch", "yaw", "roll")}

    def tip(self) -> tuple[np.ndarray, Rotation]:
        """Place [m] and orientation."""
        model, data = self._world.model, self._world.data
        for name, value in dict(self.q).items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        body = model.body(f"{ARM}_{self._arm.instrument.tip_link}").id
        return data.xpos[body].copy(), Rotation.from_matrix(data.xmat[body].reshape(3, 3))


def test_the_tip_turns_as_the_hand_does(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    """About each axis of the picture, by the same angle, in its place."""
    import rospy
    from std_msgs.msg import String

    graph, wait = ros_graph, ros_graph.wait_for
    for node in system.nodes(SystemPlan(CELL, (ARM,), False, (), tmp_path, record=False)):
        graph.node(node.package, node.executable, node.name, node.params, arguments=node.arguments)
    params: dict[str, object] = {"cell": CELL, "leader": "crtk", "settings": {"name": "hand"}}
    params |= {"scale": 0.5, "view": VIEW, "picture": ""}
    graph.node("surg_teleop", "teleop_node", "/teleop", params)
    hand, truth, states = MovingHand(), Mujoco(), [""]
    said = rospy.Subscriber(f"/hand_{ARM}/current_state", String, lambda m: states.append(m.data))
    try:
        ends = [*hand.outputs(), *truth.ends, said]
        wait(lambda: all(end.get_num_connections() for end in ends), 40.0, "everybody")

        def follows() -> bool:
            if states[-1] != "FOLLOWING":
                hand.enable.publish(True)
                time.sleep(0.3)
            return states[-1] == "FOLLOWING"

        R_VW = Rotation.from_quat(VIEW).inv()

        def turns(by: np.ndarray) -> bool:
            """Whether the tip did what the hand did; not where a starved machine let go."""
            wait(follows, 20.0, "the arm to follow")
            time.sleep(0.5)
            (place, begun), start = truth.tip(), Rotation.from_quat(hand.q)
            for k in range(1, 51):
                hand.q = (Rotation.from_rotvec(k / 50 * by) * start).as_quat()
                time.sleep(0.02)

            def off() -> float:
                did = R_VW * truth.tip()[1] * begun.inv() * R_VW.inv()
                return float((did * Rotation.from_rotvec(by).inv()).magnitude())

            wait(lambda: states[-1] != "FOLLOWING" or off() < OFF, 5.0, f"{by} rad of the hand")
            if states[-1] != "FOLLOWING":
                return False
            assert np.linalg.norm(truth.tip()[0] - place) < STILL
            return True

        for axis in np.eye(3):
            for sign in (1.0, -1.0):
                assert any(turns(sign * TURN * axis) for _ in range(TRIES)), states[-5:]
    finally:
        said.unregister()
        for end in truth.ends:
            end.unregister()
        hand.close()
