"""The capture node in the place of the simulator's endoscope: what its readers get."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import endoscope_files
from helpers.graph.ros import RosGraph
from helpers.perception import recorded_pairs
from surg_console.web import picture_packet
from surg_core import lens_file
from surg_perception.capture import eye_lenses

pytestmark = pytest.mark.ros

RATE = 30
COUNT = 90
MOST_MS = 40.0


class Eyes:
    """What arrives of both eyes."""

    def __init__(self, pictures: bool = True) -> None:
        import rospy
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import CameraInfo, Image

        self.images: dict[str, list[Any]] = {"left": [], "right": []}
        self.infos: dict[str, list[Any]] = {"left": [], "right": []}
        self.diagnostics: list[Any] = []
        self.inputs = [rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)]
        for eye in self.images if pictures else ():
            keys = {"tcp_nodelay": True, "buff_size": 1 << 24}
            root = f"/endoscope/{eye}"
            self.inputs += [
                rospy.Subscriber(f"{root}/image_raw", Image, self.images[eye].append, **keys),
                rospy.Subscriber(f"{root}/camera_info", CameraInfo, self.infos[eye].append),
            ]

    def _on_diagnostics(self, message: Any) -> None:
        self.diagnostics += [s for s in message.status if s.name == "endoscope"]

    def close(self) -> None:
        for each in self.inputs:
            each.unregister()


def picture(message: Any) -> recorded_pairs.Image:
    flat = np.frombuffer(message.data, np.uint8)
    return flat.reshape(message.height, message.width, 3)


def test_a_file_has_the_topics_of_an_endoscope(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    cell = endoscope_files.copied_cell(tmp_path, "sim_ur5e")
    recorded_pairs.side_by_side(cell / "pairs.mp4", COUNT, 320, 240)
    eyes = Eyes()
    for eye in eyes.images:
        lens_file.write_lens(cell / f"calibration/endoscope_{eye}.yaml", endoscope_files.lens(eye))
    params: dict[str, object] = {"source": "file:pairs.mp4", "layout": "sbs", "cell": str(cell)}
    try:
        ros_graph.node("surg_perception", "capture_node.py", "/endoscope", params)
        ros_graph.wait_for(
            lambda: any("ended" in s.message for s in eyes.diagnostics), 30.0, "the recording's end"
        )
    finally:
        eyes.close()
    left, right = eyes.images.values()
    assert {m.header.frame_id for m in left} == {eye_lenses.FRAMES["left"]}
    assert {m.header.frame_id for m in right} == {eye_lenses.FRAMES["right"]}
    assert [m.header.stamp for m in left] == [m.header.stamp for m in right]
    numbers = [recorded_pairs.number_of(picture(m)) for m in left]
    assert numbers == list(range(numbers[0], COUNT)), "the subscription may come late, no more"
    assert len(numbers) > COUNT - 30
    assert [recorded_pairs.number_of(picture(m)) for m in right] == numbers
    assert picture(left[0]).mean() > picture(right[0]).mean() + 30, "each its own half"
    info = eyes.infos["right"][-1]
    assert (info.width, info.height, info.K[0]) == (320, 240, pytest.approx(0.7 * 320))
    assert -info.P[3] / info.P[0] == pytest.approx(0.004), "the baseline is not scaled"


class Console:
    """The console's encoder, as the console starts it; its packets and when they came."""

    def __init__(self, env: dict[str, str]) -> None:
        argv = [sys.executable, "-m", "surg_console.ros.video_node", "video", "left,right"]
        self._process = subprocess.Popen(
            argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env
        )
        assert self._process.stdin is not None
        self._process.stdin.write(b"want stereo:h264\n")
        self._process.stdin.flush()

    def packets(self, seconds: float) -> list[tuple[int, int]]:
        """Stamp and arrival of each picture [us]."""
        found: list[tuple[int, int]] = []
        out = self._process.stdout
        assert out is not None
        end = None
        while end is None or time.monotonic() < end:
            header = out.read(picture_packet.HEADER_BYTES)
            packet = picture_packet.unpack(header + out.read(picture_packet.size_of(header)))
            end = end or time.monotonic() + seconds
            found.append((packet.exposed_us, time.time_ns() // 1000))
        return found

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def test_no_picture_is_lost_on_the_way_to_the_console(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path, full: bool
) -> None:
    if not full:
        pytest.skip("five minutes; SURG_TEST_FULL=1")
    seconds = 300.0
    video = recorded_pairs.side_by_side(tmp_path / "pairs.mp4", COUNT)
    console, eyes = Console(ros_graph.env), Eyes(pictures=False)
    params: dict[str, object] = {
        "source": f"file:{video}?loop=1", "layout": "sbs", "rate": RATE,
    }  # fmt: skip
    try:
        ros_graph.node("surg_perception", "capture_node.py", "/endoscope", params)
        packets = console.packets(seconds)[RATE:]
    finally:
        console.close()
        eyes.close()
    published = int({v.key: v.value for v in eyes.diagnostics[-1].values}["published"])
    stamps = np.array([stamp for stamp, _ in packets])
    ages = np.array([arrived - stamp for stamp, arrived in packets]) * 1e-3
    steps = np.diff(stamps) * 1e-6 * RATE
    lost = int(np.round(steps).sum()) - len(steps)
    found = (
        f"{published} pairs published, {len(packets)} arrived, {lost} lost; stamp to console "
        f"{np.median(ages):.1f} ms p50, {np.percentile(ages, 99):.1f} ms p99"
    )
    print(found)
    assert lost == 0, found
    assert np.median(ages) <= MOST_MS


def test_another_drivers_topics_are_paired(
    ros_graph: RosGraph, rospy_node: str, full: bool
) -> None:
    if not full:
        pytest.skip("SURG_TEST_FULL=1")
    import cv2
    import rospy
    from sensor_msgs.msg import CompressedImage, Image

    keys: dict[str, Any] = {"queue_size": 5, "tcp_nodelay": True}
    left = rospy.Publisher("/driver/left", Image, **keys)
    right = rospy.Publisher("/driver/right/compressed", CompressedImage, **keys)
    eyes = Eyes()
    params: dict[str, object] = {
        "source": "ros:/driver/left,/driver/right/compressed", "layout": "two", "rate": 10.0,
    }  # fmt: skip
    try:
        ros_graph.node("surg_perception", "capture_node.py", "/endoscope", params)
        ends = (left, right, *eyes.inputs)
        ros_graph.wait_for(lambda: all(e.get_num_connections() for e in ends), 30.0, "the node")
        sent = []
        for number in range(20):
            time.sleep(0.1)
            stamp = time.time_ns()
            sent.append(stamp + 1_500_000)
            picture_ = recorded_pairs.scene(number, 320, 240)
            message = Image(height=240, width=320, step=320 * 3, encoding="bgr8")
            message.data = picture_[..., ::-1].tobytes()
            message.header.stamp = rospy.Time(*divmod(stamp, 10**9))
            _, jpeg = cv2.imencode(".jpg", picture_[..., ::-1])
            coded = CompressedImage(format="jpeg", data=jpeg.tobytes())
            coded.header.stamp = rospy.Time(*divmod(stamp + 3_000_000, 10**9))
            left.publish(message)
            right.publish(coded)
        ros_graph.wait_for(lambda: len(eyes.images["right"]) >= 18, 10.0, "pairs")
    finally:
        eyes.close()
        left.unregister()
        right.unregister()
    for messages in eyes.images.values():
        assert {m.header.stamp.to_nsec() for m in messages} <= set(sent)
        numbers = [recorded_pairs.number_of(picture(m)) for m in messages]
        assert numbers == sorted(numbers)
        first = picture(messages[0]).astype(int)
        expected = recorded_pairs.scene(numbers[0], 320, 240).astype(int)
        assert np.abs(first - expected).mean() < 5, "red stays red"
