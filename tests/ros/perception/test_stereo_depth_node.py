"""The node ``/eyes`` in a graph: depth and marks of pictures that a test sends."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.graph.ros import RosGraph
from helpers.perception.live_eyes import camera_info, image
from helpers.perception.plane_pair import PlanePair
from surg_cli.host import paths
from surg_core.lens_file import Lens

pytestmark = pytest.mark.ros

CELL = paths.CELLS / "sim_two_arms"


class Sender:
    """Sends one pair again and again, with camera_info and joints, at 20/s."""

    def __init__(self, pair: PlanePair) -> None:
        import rospy
        from sensor_msgs.msg import CameraInfo, Image, JointState

        cell = surg_core.load_cell(CELL)
        self.pair, self.pictures, self.lenses = pair, pair.pictures(), list(pair.lenses())
        self._images, self._infos, self._joints = [], [], []
        for eye in ("left", "right"):
            root = f"/endoscope/{eye}"
            self._images.append(rospy.Publisher(f"{root}/image_raw", Image, queue_size=2))
            self._infos.append(
                rospy.Publisher(f"{root}/camera_info", CameraInfo, queue_size=2, latch=True)
            )
        for name, arm in cell.arms.items():
            state = JointState(name=list(arm.robot.joint_names), position=list(arm.robot.home))
            topic = f"/{name}/robot/measured_js"
            self._joints.append((rospy.Publisher(topic, JointState, queue_size=2), state))
        self.moving = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        import rospy

        while not self._stop.wait(0.05):
            now = rospy.Time.now()
            for publisher, state in self._joints if self.moving else ():
                state.header.stamp = now
                publisher.publish(state)
            for eye, info, picture, lens in zip(
                self._images, self._infos, self.pictures, self.lenses, strict=True
            ):
                info.publish(camera_info(lens, now))
                eye.publish(image(picture, now, lens.camera_name))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def sender(ros_graph: RosGraph, rospy_node: str) -> Iterator[Sender]:
    made = Sender(PlanePair(distance=0.06))
    yield made
    made.close()


class Listener:
    """Keeps what arrives on a topic."""

    def __init__(self, topic: str, kind: type) -> None:
        import rospy

        self.messages: list[Any] = []
        self.subscriber = rospy.Subscriber(
            topic, kind, self.messages.append, queue_size=5, buff_size=1 << 24
        )


def test_depth_and_points_of_a_pair(sender: Sender, ros_graph: RosGraph) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import Image, PointCloud2

    params = {"depth": True, "marks": True, "cell": str(CELL), "rate": 5.0}
    diagnostics = Listener("/diagnostics", DiagnosticArray)

    def told() -> str:
        found = [s for m in diagnostics.messages for s in m.status if s.name == "eyes"]
        return found[-1].message if found else ""

    node = ros_graph.node("surg_perception", "stereo_depth_node.py", "/eyes", params)
    depth = Listener("/endoscope/depth", Image)
    cloud = Listener("/endoscope/points2", PointCloud2)
    rect = Listener("/endoscope/right/image_rect", Image)
    everything = (depth, cloud, rect)
    ros_graph.wait_for(lambda: all(len(x.messages) > 3 for x in everything), 40.0, "three topics")
    pair, message = sender.pair, depth.messages[-1]
    assert message.encoding == "32FC1" and message.header.frame_id == "endoscope_left"
    found = np.frombuffer(message.data, "<f4").reshape(message.height, message.width)
    away = np.abs(found - pair.depth())[20:-20, 60:-20]
    assert np.nanmedian(away) < 0.001 and np.isfinite(away).mean() > 0.8
    points = np.frombuffer(cloud.messages[-1].data, [("p", "<f4", 3), ("rgb", "<u4")])["p"]
    normal, place = pair.X_LBoard[:3, 2], pair.X_LBoard[:3, 3]
    assert np.median(np.abs((points - place) @ normal)) < 0.001, "on the true plane, raw left eye"
    ros_graph.wait_for(lambda: told() == "ok", 10.0, "the node's report")
    stamps = [m.header.stamp.to_sec() for m in depth.messages]
    assert len(stamps) <= 5.0 * (stamps[-1] - stamps[0]) + 3, "no more than ~rate"
    # A lens that nobody has measured: silence and a reason; a good one: it goes on.
    good = sender.lenses[0]
    sender.lenses[0] = Lens(
        good.width, good.height, good.camera_name, 0.0 * good.K, "plumb_bob", good.D, good.R, good.P
    )
    ros_graph.wait_for(lambda: "has no focal length" in told(), 20.0, "the reason")
    sender.lenses[0] = good
    before = len(depth.messages)
    ros_graph.wait_for(lambda: len(depth.messages) > before + 2, 20.0, "depth again")
    # Pictures of another size than their lens, and of one colour only.
    sender.pictures = (sender.pictures[0], sender.pictures[1][::2, ::2].copy())
    ros_graph.wait_for(lambda: "the right picture has 160 x 120" in told(), 20.0, "the reason")
    assert node.exit_code is None


def test_marks_come_with_every_picture_and_need_none(sender: Sender, ros_graph: RosGraph) -> None:
    """At the pictures' own rate, not the node's; the pictures themselves are not fetched."""
    from surg_msgs.msg import PictureMarks

    params = {"depth": False, "marks": True, "cell": str(CELL), "rate": 1.0}
    ros_graph.node("surg_perception", "stereo_depth_node.py", "/eyes", params)
    marks = Listener("/endoscope/marks", PictureMarks)
    ros_graph.wait_for(lambda: len(marks.messages) > 20, 30.0, "marks")
    newest = marks.messages[-1]
    stamps = np.array([m.header.stamp.to_sec() for m in marks.messages[-20:]])
    assert 1.0 / np.diff(stamps).mean() > 10.0, "not held back by ~rate"
    assert (newest.width, newest.height) == sender.pictures[0].shape[1::-1]
    assert {mark.eye for mark in newest.marks} == {"left", "right"}
    assert {mark.name for mark in newest.marks} >= {"tip", "shaft", "trocar"}
    assert all(images.get_num_connections() == 0 for images in sender._images)
    # The joints fall silent: no marks, for they would lie.
    sender.moving = False
    time.sleep(0.5)
    before = len(marks.messages)
    time.sleep(0.5)
    assert len(marks.messages) == before
