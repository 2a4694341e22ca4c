"""The elbow of the simulated Panda, turned while the tip rests: simulator, controller and client.

The swivel angle's oracle is the published Denavit-Hartenberg formula on the simulated joints.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import rospy
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from helpers.control import dh
from helpers.graph.crtk_client import Arm, Group, LockstepTime, position
from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_msgs.msg import Cycle

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

TOLERANCE = 2e-3
"""[rad] As docs/reference/conventions.md states it."""


def swivel(q: NDArray[np.float64]) -> float:
    """Angle of the Panda's elbow about shoulder and wrist, from the vertical half-plane [rad]."""
    pose, origins = np.eye(4), []
    for angle, (a, d, alpha) in zip(q[:6], dh.PANDA[:6], strict=True):
        ct, st, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        origins.append(pose[:3, 3])
    line = origins[5] - origins[1]
    up = np.cross(line, [0.0, 0.0, 1.0])
    bent = np.cross(line, origins[3] - origins[1])
    sine = np.dot(np.cross(up, bent), line) / np.linalg.norm(line)
    return math.atan2(sine, float(np.dot(up, bent)))


def start(graph: RosGraph, cell: str, me: str) -> None:
    shared = {"cell": paths.ROOT / "cells" / cell, "mode": "lockstep", "participants": [me]}
    graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})


class Watched:
    """A CRTK client with an elbow, every cycle and every warning."""

    def __init__(self, graph: RosGraph, node: str) -> None:
        self.cycles: list[Cycle] = []
        self.warnings: list[str] = []
        self.clock = LockstepTime(node, "PSM1")
        self.arm = Arm("PSM1", self.clock)
        self.elbow = Group("PSM1/elbow", self.clock)
        self.arm.groups.append(self.elbow)
        self._move = self.elbow.speak("move_jp", JointState)
        self.elbow.listen("measured_js", JointState)
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._ears = [
            rospy.Subscriber("/PSM1/cycle", Cycle, self.cycles.append, **keys),
            rospy.Subscriber("/PSM1/warning", String, lambda m: self.warnings.append(m.data)),
        ]
        self.arm.check_connections()
        graph.wait_for(self.clock.connected, 20.0, "the clock")
        graph.wait_for(lambda: all(e.get_num_connections() for e in self._ears), 20.0, "ears")
        self.arm.sleep(0.02)
        assert self.arm.enable(1.0) and self.arm.home(1.0)

    def turn(self, angle: float, timeout: float) -> bool:
        begun = self.clock.now()
        self._move(JointState(position=[angle]))
        return self.arm.wait_for_busy(False, begun, timeout)

    def close(self) -> None:
        self.arm.close()
        self.clock.close()
        for ear in self._ears:
            ear.unregister()


def test_the_elbow_turns_and_the_tip_stays(ros_graph: RosGraph, rospy_node: str) -> None:
    start(ros_graph, "sim_panda", rospy_node.lstrip("/"))
    seen = Watched(ros_graph, rospy_node)
    try:
        p_tip = position(seen.arm.get("measured_cp"))
        before = swivel(np.array(seen.cycles[-1].q))
        begun = len(seen.cycles)
        assert seen.turn(before + 0.25, 20.0), seen.warnings
        seen.arm.sleep(1.0)
        after = swivel(np.array(seen.cycles[-1].q))
        reported = seen.elbow.get("measured_js").position[0]
        sway = np.linalg.norm(position(seen.arm.get("measured_cp")) - p_tip)
        turning = seen.cycles[begun:]
        pivot = max(cycle.rcm_error for cycle in turning)
        print(
            f"{before:.3f} to {after:.4f} rad, tip {sway * 1e6:.1f} um, pivot {pivot * 1e6:.1f} um"
        )
        assert after == pytest.approx(before + 0.25, abs=TOLERANCE + 1e-4)
        assert reported == pytest.approx(after, abs=1e-3)
        assert {cycle.state for cycle in turning} == {Cycle.ENABLED}
        assert pivot < 5e-6  # links that lag by different times
        assert sway < 1e-6
        # Far beyond every joint limit: refused, and the warning names what is in the way.
        seen.turn(math.pi, 0.1)
        seen.arm.sleep(0.1)
        assert any("elbow/move_jp" in w and "limit" in w for w in seen.warnings), seen.warnings
    finally:
        seen.close()


def test_an_arm_of_six_joints_has_no_elbow(ros_graph: RosGraph, rospy_node: str) -> None:
    start(ros_graph, "sim_ur5e", rospy_node.lstrip("/"))
    seen = Watched(ros_graph, rospy_node)
    try:
        seen.turn(0.2, 0.1)
        seen.arm.sleep(0.1)
        assert any("seven joints" in w for w in seen.warnings), seen.warnings
        assert np.abs(seen.cycles[-1].qd_command).max() < 1e-6
    finally:
        seen.close()
