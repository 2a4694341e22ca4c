"""The endoscope node beside the bridge: every snapshot becomes one picture with its stamp."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from surg_cli.host import paths

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

CELL = paths.ROOT / "cells" / "sim_ur5e"
TICK_NS = 2_000_000


class Listener:
    """Publishes snapshots and keeps what comes back."""

    def __init__(self) -> None:
        import rospy
        from sensor_msgs.msg import CameraInfo, Image

        from surg_msgs.msg import Ready, SimSnapshot

        self.images: list[Image] = []
        self.infos: list[CameraInfo] = []
        self.ready: list[Ready] = []
        self.snapshots = rospy.Publisher("/sim/snapshot", SimSnapshot, queue_size=0)
        self.topics = [
            self.snapshots,
            rospy.Subscriber("/endoscope/left/image_raw", Image, self.images.append),
            rospy.Subscriber("/endoscope/left/camera_info", CameraInfo, self.infos.append),
            rospy.Subscriber("/sim/ready", Ready, self.ready.append),
        ]

    def connected(self) -> bool:
        return all(topic.get_num_connections() for topic in self.topics)

    def close(self) -> None:
        for topic in self.topics:
            topic.unregister()


def test_every_snapshot_is_rendered_in_lockstep(ros_graph: RosGraph, rospy_node: str) -> None:
    import rospy

    import surg_core
    from surg_msgs.msg import SimSnapshot
    from surg_sim.physics.world import World

    world = World(surg_core.load_cell(CELL))
    listener = Listener()
    params = {"cell": str(CELL), "mode": "lockstep", "width": 320, "height": 240}
    child = ros_graph.node("surg_sim", "endoscope_node.py", "/endoscope", params)
    try:
        ros_graph.wait_for(
            lambda: child.exit_code is not None or listener.connected(), 60.0, "the endoscope"
        )
        if child.exit_code == 1 and "OpenGL" in child.log_tail():
            pytest.skip(child.log_tail())
        ros_graph.wait_for(lambda: bool(listener.infos), 5.0, "the latched camera_info")
        ticks = [25 * k for k in range(1, 31)]
        began = time.monotonic()
        for tick in ticks:
            snapshot = SimSnapshot(tick=tick, qpos=world.data.qpos.tolist())
            snapshot.qpos[0] += 0.001 * tick / 25
            snapshot.header.stamp = rospy.Time(*divmod(tick * TICK_NS, 10**9))
            listener.snapshots.publish(snapshot)
        ros_graph.wait_for(lambda: len(listener.ready) == len(ticks), 30.0, "30 pictures")
        seconds = time.monotonic() - began
        ros_graph.wait_for(lambda: len(listener.images) == len(ticks), 10.0, "30 images")
    finally:
        ros_graph.supervisor.stop([child])
        listener.close()
    print(f"{len(ticks) / seconds:.0f} frames/s at 320x240")
    assert [m.tick for m in listener.ready] == ticks
    assert {m.participant for m in listener.ready} == {"endoscope"}
    assert [m.header.stamp.to_nsec() for m in listener.images] == [t * TICK_NS for t in ticks]
    image, info = listener.images[0], listener.infos[-1]
    assert (image.encoding, image.width, image.height, image.step) == ("rgb8", 320, 240, 960)
    assert image.header.frame_id == info.header.frame_id == "endoscope_left"
    pixels = np.frombuffer(image.data, np.uint8).reshape(240, 320, 3)
    assert pixels.std() > 20
    assert image.data != listener.images[-1].data
    f = 120 / np.tan(np.radians(28))
    assert list(info.K) == pytest.approx([f, 0, 159.5, 0, f, 119.5, 0, 0, 1])


class Eye:
    """Keeps what one view of the endoscope sends."""

    def __init__(self, view: str) -> None:
        import rospy
        from sensor_msgs.msg import CameraInfo, Image

        self.images: list[Image] = []
        self.infos: list[CameraInfo] = []
        self.probed = False
        root = f"/endoscope/{view}"
        self.topics = [
            rospy.Subscriber(f"{root}/image_raw", Image, self._on_image),
            rospy.Subscriber(f"{root}/camera_info", CameraInfo, self.infos.append),
        ]

    def _on_image(self, image: Any) -> None:
        """Of a probe: without a stamp."""
        if image.header.stamp.is_zero():
            self.probed = True
        else:
            self.images.append(image)


def test_a_published_pair_triangulates_a_bead(ros_graph: RosGraph, rospy_node: str) -> None:
    """2 mm bead at 60 mm from both topics, with the P of their camera_info and nothing else."""
    import rospy
    from tf2_msgs.msg import TFMessage

    import surg_core
    from helpers.sim.bead_task import BeadTask
    from helpers.sim.beads import centre, triangulate
    from surg_msgs.msg import SimSnapshot
    from surg_sim.physics import endoscope_rig, scene
    from surg_sim.physics.world import World

    path = paths.ROOT / "cells" / "sim_two_arms"
    cell = surg_core.load_cell(path)
    world = World(cell, task=BeadTask())
    site = scene.site_of(list(cell.arms.values()))
    slides = [int(world.model.joint(f"bead_{letter}").qposadr[0]) for letter in "xyz"]
    arm = cell.arms["ECM"]
    X_WC = arm.X_WB @ arm.chain.forward(arm.robot.home) @ endoscope_rig.camera_poses(arm)[0]
    snapshots = rospy.Publisher("/sim/snapshot", SimSnapshot, queue_size=0)
    eyes = [Eye("left"), Eye("right")]
    frames: list[TFMessage] = []
    tf_static = rospy.Subscriber("/tf_static", TFMessage, frames.append)
    topics = [snapshots, tf_static, *eyes[0].topics, *eyes[1].topics]
    params = {
        "cell": str(path),
        "mode": "lockstep",
        "task": str(paths.ROOT / "tests" / "helpers" / "sim" / "bead_task.py"),
        "views": ["left", "right"],
    }
    child = ros_graph.node("surg_sim", "endoscope_node.py", "/endoscope", params)
    rng = np.random.default_rng(8)
    places = [np.array([*rng.uniform(-0.012, 0.012, 2), 0.060]) for _ in range(6)]
    try:
        ros_graph.wait_for(
            lambda: (
                child.exit_code is not None or all(topic.get_num_connections() for topic in topics)
            ),
            40.0,
            "the endoscope",
        )
        if child.exit_code == 1 and "OpenGL" in child.log_tail():
            pytest.skip(child.log_tail())

        def probed() -> bool:
            """A connection that one end counts may not stand at the other yet."""
            snapshots.publish(SimSnapshot(qpos=world.data.qpos.tolist()))
            return all(eye.probed for eye in eyes)

        ros_graph.wait_for(probed, 40.0, "a first pair")
        for k, p_C in enumerate(places, start=1):
            qpos = np.array(world.data.qpos)
            qpos[slides] = X_WC[:3, :3] @ p_C + X_WC[:3, 3] - site.work
            snapshot = SimSnapshot(tick=25 * k, qpos=qpos.tolist())
            snapshot.header.stamp = rospy.Time(*divmod(25 * k * TICK_NS, 10**9))
            snapshots.publish(snapshot)
        ros_graph.wait_for(
            lambda: all(len(eye.images) == len(places) for eye in eyes), 40.0, "six pairs"
        )
    finally:
        ros_graph.supervisor.stop([child])
        for topic in topics:
            topic.unregister()
    left, right = eyes
    stamps = [[m.header.stamp.to_nsec() for m in eye.images] for eye in eyes]
    assert stamps[0] == stamps[1] == [25 * k * TICK_NS for k in range(1, len(places) + 1)]
    assert right.images[0].header.frame_id == right.infos[-1].header.frame_id == "endoscope_right"
    P_left, P_right = (np.array(eye.infos[-1].P).reshape(3, 4) for eye in eyes)
    assert P_right[0, 3] == pytest.approx(-0.004 * P_left[0, 0], abs=1e-9)
    errors = []
    for p_C, *pair in zip(places, left.images, right.images, strict=True):
        pictures = [np.frombuffer(m.data, np.uint8).reshape(m.height, m.width, 3) for m in pair]
        found = triangulate([P_left, P_right], [centre(picture) for picture in pictures])
        errors.append(float(np.linalg.norm(found - p_C)))
    print(f"worst {1e3 * max(errors):.3f} mm of {len(errors)}")
    assert max(errors) < 0.0005
    drawn, drawn_right = endoscope_rig.camera_poses(arm)
    wanted = {
        ("ECM_flange", "endoscope_left"): drawn,
        ("endoscope_left", "endoscope_right"): np.linalg.inv(drawn) @ drawn_right,
    }
    found_frames = {(t.header.frame_id, t.child_frame_id): t for t in frames[0].transforms}
    assert set(found_frames) == set(wanted)
    for name, X in wanted.items():
        to, turn = found_frames[name].transform.translation, found_frames[name].transform.rotation
        q = [turn.x, turn.y, turn.z, turn.w]
        np.testing.assert_allclose([to.x, to.y, to.z], X[:3, 3], atol=1e-9)
        R = surg_core.quaternion_xyzw_to_matrix(q)
        np.testing.assert_allclose(R, X[:3, :3], atol=1e-9)
