"""The recorder node before cameras of any type: raw, compressed, and what is no camera."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture

from helpers.graph.ros import RosGraph
from helpers.graph.twin_publisher import TwinPublisher
from helpers.recording import picture_identity
from helpers.recording.picture_identity import HEIGHT, WIDTH, Identity
from surg_cli.graph import master

rospy = pytest.importorskip("rospy")
surg_msgs = pytest.importorskip("surg_msgs.msg")

from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402
from std_msgs.msg import Bool, Int64  # noqa: E402

from surg_recording.episode import episode_reader  # noqa: E402
from surg_recording.video import video_file  # noqa: E402

pytestmark = pytest.mark.ros

FRAMES = 20
CAMERAS = ["/raw/image_raw", "/scope/image_raw/compressed", "/any/name", "/no/camera"]

K = [450.0, 0.0, 31.5, 0.0, 451.0, 23.5, 0.0, 0.0, 1.0]


class Bench:
    """Publishers of cameras, and ears for the recorder."""

    def __init__(self) -> None:
        kinds = (Image, CompressedImage, CompressedImage, Int64)
        self.cameras = [
            rospy.Publisher(topic, kind, queue_size=0)
            for topic, kind in zip(CAMERAS, kinds, strict=True)
        ]
        # Latched, as the endoscope's: said once, before anybody records.
        self.model = rospy.Publisher("/raw/camera_info", CameraInfo, queue_size=1, latch=True)
        self.model.publish(
            CameraInfo(width=WIDTH, height=HEIGHT, K=K, distortion_model="plumb_bob")
        )
        self.cycle = rospy.Publisher("/PSM1/cycle", surg_msgs.Cycle, queue_size=0)
        self.record = rospy.Publisher("/record/record", Bool, queue_size=0)
        self.status = surg_msgs.RecordStatus()
        self._ear = rospy.Subscriber("/record/status", surg_msgs.RecordStatus, self._on_status)

    def _on_status(self, message: Any) -> None:
        self.status = message

    def frames(self) -> set[int]:
        camera = surg_msgs.RecordStream.KIND_CAMERA
        return {one.received for one in self.status.streams if one.kind == camera}

    def connected(self) -> bool:
        ends = [*self.cameras, self.model, self.cycle, self.record]
        return all(end.get_num_connections() > 0 for end in ends)

    def send(self, number: int) -> CompressedImage:
        """Frame ``number`` of every camera; returns the PNG one."""
        stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
        self.cycle.publish(surg_msgs.Cycle(tick=number, state=1, q=[0.0] * 6, qd=[0.0] * 6))
        raw = Image(width=WIDTH, height=HEIGHT, step=3 * WIDTH, encoding="rgb8")
        raw.data = self.picture(0, number).tobytes()
        jpeg = CompressedImage(
            format="rgb8; jpeg compressed bgr8", data=self.coded(1, number, "jpeg")
        )
        png = CompressedImage(format="png", data=self.coded(2, number, "png"))
        if number == 7:
            jpeg.data = jpeg.data[:-100]
        for message in (raw, jpeg, png):
            message.header.stamp = stamp
        for publisher, message in zip(self.cameras, (raw, jpeg, png, Int64(5)), strict=True):
            publisher.publish(message)
        return png

    @staticmethod
    def picture(recording: int, number: int) -> np.ndarray:
        return picture_identity.draw(Identity(recording, 0, number))

    def coded(self, recording: int, number: int, kind: str) -> bytes:
        file = io.BytesIO()
        Picture.fromarray(self.picture(recording, number)).save(file, kind)
        return file.getvalue()

    def close(self) -> None:
        for end in (*self.cameras, self.model, self.cycle, self.record, self._ear):
            end.unregister()


@pytest.fixture
def bench(rospy_node: str, ros_graph: RosGraph) -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_any_image_topic_is_recorded_raw_or_compressed(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    parameters = {"out": str(tmp_path / "e"), "mode": "freerun", "min_free_bytes": 0}
    ros_graph.node(
        "surg_recording", "recorder_node", "/recorder", {**parameters, "cameras": CAMERAS}
    )
    ros_graph.wait_for(bench.connected, 60, "the recorder")
    twin = TwinPublisher(rospy.get_name(), CAMERAS[2], "sensor_msgs/CompressedImage")
    try:
        own = master.call(ros_graph.uri, "lookupNode", rospy.get_name())
        node = master.call(ros_graph.uri, "lookupNode", "/recorder")
        master.call(node, "publisherUpdate", CAMERAS[2], [own, twin.uri])
        ros_graph.wait_for(lambda: twin.listener is not None, 20, "a second connection")
        for number in range(1, FRAMES + 1):
            twin.send(bench.send(number))
            time.sleep(0.03)
        ros_graph.wait_for(
            lambda: bench.frames() == {0, FRAMES - 1, FRAMES},
            60,
            "every frame",
        )
    finally:
        twin.close()
    bench.record.publish(False)
    ros_graph.wait_for(lambda: bool(bench.status.finished), 20, "the episode")
    recorded = episode_reader.read(bench.status.finished)
    assert recorded.cameras == ["any_name", "raw", "scope"]
    for recording, camera in enumerate(("raw", "scope", "any_name")):
        video = recorded.video(camera)
        expected = [k for k in range(1, FRAMES + 1) if (camera, k) != ("scope", 7)]
        images = video_file.grab(video.path, list(range(len(expected))))
        found = [picture_identity.read(image) for image in images]
        assert found == [Identity(recording, 0, k) for k in expected]
    model = recorded.manifest["camera_info"]
    assert list(model) == ["raw"], "the only camera that has said it"
    assert (model["raw"]["width"], model["raw"]["K"]) == (WIDTH, K)
    assert recorded.manifest["repeats"] == {CAMERAS[2]: FRAMES}
    reason, warnings = recorded.manifest["reason"], "; ".join(recorded.warnings)
    assert "scope: 1 dropped (the last that could not be recorded: a JPEG picture that is" in reason
    assert "no_camera: no image was received" in reason
    assert "/no/camera: not recorded as a camera: its type is std_msgs/Int64" in warnings
