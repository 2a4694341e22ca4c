"""The console's side of a plan: topics in, a place in the picture out; silent until asked."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest
import rospy
from sensor_msgs.msg import CameraInfo, JointState

import surg_core
from helpers.endoscope_files import lens
from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_core.held_endoscope import held_endoscope
from surg_msgs.msg import Cycle, PolicyPlan
from surg_teleop.console.ros.plan_topics_node import PlanTopics

CELL = surg_core.load_cell(paths.CELLS / "sim_two_arms")
LENS = lens("left")
SEEN = np.array([[-0.01, 0.002, 0.08], [0.012, -0.004, 0.1]])
"""[m] Planned tips before the left eye."""


def camera_info() -> CameraInfo:
    info = CameraInfo(width=640, height=480, distortion_model="plumb_bob")
    for key in ("D", "K", "R", "P"):
        setattr(info, key, np.ravel(getattr(LENS, key)).tolist())
    return info


@pytest.mark.ros
@pytest.mark.full
def test_a_plan_on_topics_has_its_place_in_the_picture(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    held = held_endoscope(CELL)
    assert held is not None
    q = np.array(CELL.arms[held.arm].robot.home) + 0.01
    X_WV = held.X_WB @ np.asarray(held.chain.forward(q)) @ np.asarray(held.X_FV)
    # The rcm frame: turned by a third about (1, 1, 1), that is x to y to z, at the trocar.
    X_BR = np.eye(4)
    X_BR[:3, :3], X_BR[:3, 3] = np.roll(np.eye(3), 1, axis=0), [0.4, 0.1, 0.3]
    X_RV = np.linalg.inv(np.asarray(CELL.arms["PSM1"].X_WB) @ X_BR) @ X_WV
    p_R = SEEN @ X_RV[:3, :3].T + X_RV[:3, 3]
    rows = np.hstack([p_R, np.zeros((2, 2))])
    names = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
    plan = PolicyPlan(names=names, rows=2, values=rows.ravel().tolist(), area=[0, 0, 1, 1])
    plan.keypoints, plan.x, plan.y, plan.certainty = ["tip"], [0.5], [0.25], [1.0]

    kinds: dict[str, tuple[type, Any]] = {
        "/PSM1/cycle": (Cycle, Cycle(q_br=[0.5, 0.5, 0.5, 0.5], p_rcm=X_BR[:3, 3].tolist())),
        f"/{held.arm}/robot/measured_js": (
            JointState,
            JointState(name=[joint.name for joint in held.chain.joints], position=q.tolist()),
        ),
        "/endoscope/left/camera_info": (CameraInfo, camera_info()),
        "/policy/plan": (PolicyPlan, plan),
    }
    out = {name: rospy.Publisher(name, kind, queue_size=1) for name, (kind, _) in kinds.items()}
    topics = PlanTopics(CELL)
    rospy.sleep(0.5)
    assert not any(each.get_num_connections() for each in out.values()), "nobody has asked"
    topics.watch(True)

    def placed() -> bool:
        for name, (_, message) in kinds.items():
            out[name].publish(message)
        text = topics.newest()
        return bool(text) and bool(json.loads(text)["paths"])

    ros_graph.wait_for(placed, 20.0, f"a plan in the picture ({topics.newest()})")
    found = json.loads(topics.newest())
    pixels, _ = cv2.projectPoints(SEEN, np.zeros(3), np.zeros(3), LENS.K, LENS.D)
    expected = (pixels[:, 0] + 0.5) / (640, 480)
    np.testing.assert_allclose(found["paths"][0]["points"], expected, atol=6e-5)
    assert found["keypoints"][0]["at"] == [0.5, 0.25] and found["note"] == ""
    topics.watch(False)
    assert topics.newest() == ""
    ros_graph.wait_for(
        lambda: not any(each.get_num_connections() for each in out.values()), 10.0, "the end"
    )
    topics.watch(True)  # and it can be asked again
    ros_graph.wait_for(placed, 20.0, "a plan once more")
    topics.watch(False)
