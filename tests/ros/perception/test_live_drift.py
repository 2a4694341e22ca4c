"""The watch over the picture in a running graph: what it says, and what everybody does then."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.perception.drift_bench import SCOPE, TOOL, DriftBench, Motion, Moved
from helpers.perception.live_eyes import camera_info, image
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import LEFT, RIGHT

pytestmark = pytest.mark.ros

PICTURES_S = 1.0 / 8.0
JOINTS_S = 0.01
BUMP_S, SECONDS = 6.0, 14.0
"""When somebody bumps the camera, and when the motion ends [s]."""
BUMP = Moved(camera=np.r_[np.radians([1.0, -1.5, 1.0]), 0.003, -0.002, 0.002])


class Player:
    """Sends drawn pictures, their camera_info and the joints as they come in real time."""

    def __init__(self, folder: Path) -> None:
        import rospy
        from sensor_msgs.msg import CameraInfo, Image, JointState

        self.bench = DriftBench(folder, 33)
        self.motion = Motion(self.bench.chain, 5, SECONDS, True)
        self._times = np.arange(0.0, SECONDS, PICTURES_S)
        still = Moved()
        self._pairs = [
            self.bench.pair(self.motion, at, BUMP if at >= BUMP_S else still) for at in self._times
        ]
        lenses = [load_lens(self.bench.folder / "calibration" / name) for name in (LEFT, RIGHT)]
        self._eyes = []
        for eye, lens in zip(("left", "right"), lenses, strict=True):
            root = f"/endoscope/{eye}"
            info = rospy.Publisher(f"{root}/camera_info", CameraInfo, queue_size=2, latch=True)
            pictures = rospy.Publisher(f"{root}/image_raw", Image, queue_size=2)
            self._eyes.append((pictures, info, lens))
        self._joints = {
            arm: rospy.Publisher(f"/{arm}/robot/measured_js", JointState, queue_size=10)
            for arm in (TOOL, SCOPE)
        }
        self._thread = threading.Thread(target=self._play, daemon=True)
        self.begun = 0.0

    def heard(self) -> bool:
        """Whether somebody listens to pictures and joints."""
        topics = [*self._joints.values(), *(eye for eye, *_ in self._eyes)]
        return all(each.get_num_connections() for each in topics)

    def play(self) -> None:
        self.begun = time.time()
        self._thread.start()

    def _play(self) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        number, at = 0, 0.0
        while at < self.motion.t[-1] and not rospy.is_shutdown():
            at += JOINTS_S
            time.sleep(max(0.0, self.begun + at - time.time()))
            for name, publisher in self._joints.items():
                arm = self.bench.cell.arms[name]
                state = JointState(name=list(arm.robot.joint_names))
                state.header.stamp = rospy.Time.from_sec(self.begun + at)
                q = self.motion.joints(name, at)
                assert q is not None
                state.position = q.tolist()
                publisher.publish(state)
            # A picture takes 50 ms from its exposure to its reader.
            if number < len(self._times) and at >= self._times[number] + 0.05:
                stamp = rospy.Time.from_sec(self.begun + self._times[number])
                for (eye, info, lens), picture in zip(self._eyes, self._pairs[number], strict=True):
                    info.publish(camera_info(lens, stamp))
                    eye.publish(image(picture, stamp, lens.camera_name))
                number += 1

    def close(self) -> None:
        self._thread.join()


@pytest.fixture
def player(ros_graph: RosGraph, rospy_node: str, tmp_path: Path) -> Iterator[Player]:
    made = Player(tmp_path)
    yield made
    made.close()


def heard(topic: str, kind: type) -> list[Any]:
    import rospy

    found: list[Any] = []
    rospy.Subscriber(topic, kind, lambda message: found.append((time.time(), message)))
    return found


def test_a_bump_is_said_while_the_arm_moves(player: Player, ros_graph: RosGraph) -> None:
    from surg_msgs.msg import DriftStatus, PictureMarks

    told, marks = heard("/endoscope/drift", DriftStatus), heard("/endoscope/marks", PictureMarks)
    folder = str(player.bench.folder)
    params = {"depth": False, "marks": True, "drift": True, "cell": folder}
    node = ros_graph.node("surg_perception", "stereo_depth_node.py", "/eyes", params)
    ros_graph.wait_for(player.heard, 20.0, "the node listens")
    player.play()
    bumped = player.begun + BUMP_S
    ros_graph.wait_for(lambda: any(m.refusal for _, m in told), SECONDS + 5.0, "a refusal")
    at, first = next((at, message) for at, message in told if message.refusal)
    print(f"refused {at - bumped:.1f} s after the bump: {first.detail}")
    before = [message for at, message in told if at < bumped]
    assert before and {m.state for m in before[-2:]} == {DriftStatus.STATE_STEADY}
    assert not any(m.state == DriftStatus.STATE_MOVED for m in before)
    assert bumped < at < bumped + 8.0
    assert first.state == DriftStatus.STATE_MOVED and first.least > 0.001
    assert bumped - 1.5 < first.since.to_sec() < at
    assert first.least < first.expected < first.most and "drift --from" in first.refusal
    assert any(m.marks for t, m in marks if t < bumped)
    player.close()
    assert not [t for t, m in marks if t > at + 0.5], "no mark where the picture is not trusted"
    assert told[-1][1].refusal, "once refused, always"
    assert node.exit_code is None


def test_what_nobody_can_tell_is_no_alarm(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    import rospy
    from sensor_msgs.msg import CameraInfo, Image

    from surg_msgs.msg import DriftStatus

    told, bench = heard("/endoscope/drift", DriftStatus), DriftBench(tmp_path, 33)
    params = {"depth": False, "marks": False, "drift": True, "cell": str(bench.folder)}
    node = ros_graph.node("surg_perception", "stereo_depth_node.py", "/eyes", params)

    def said(words: str) -> None:
        ros_graph.wait_for(lambda: words in (told[-1][1].detail if told else ""), 30.0, words)

    said("no pictures of both eyes with one stamp")
    motion, eyes = Motion(bench.chain, 5, 1.0, True), []
    for eye in ("left", "right"):
        pictures = rospy.Publisher(f"/endoscope/{eye}/image_raw", Image, queue_size=2)
        info = rospy.Publisher(
            f"/endoscope/{eye}/camera_info", CameraInfo, queue_size=2, latch=True
        )
        eyes.append((pictures, info))

    def show(count: int, stamps: list[Any]) -> None:
        pair = bench.pair(motion, 0.05 * count, Moved())
        names = zip(eyes, stamps, pair, (LEFT, RIGHT), strict=False)
        for (pictures, info), stamp, picture, name in names:
            info.publish(camera_info(load_lens(bench.folder / "calibration" / name), stamp))
            pictures.publish(image(picture, stamp, "eye"))
        time.sleep(0.1)

    ros_graph.wait_for(lambda: all(p.get_num_connections() for p, _ in eyes), 20.0, "the node")
    for count in range(25):  # one eye alone
        show(count % 15, [rospy.Time.now()])
    assert "no pictures of both eyes" in told[-1][1].detail
    for count in range(10):
        show(count, [rospy.Time(), rospy.Time()])
    said("the pictures have no stamp")
    for count in range(10):
        show(count, [now := rospy.Time.now(), now])
    said("no joints of ECM at the pictures' time")
    assert {message.state for _, message in told} == {DriftStatus.STATE_UNKNOWN}
    assert not any(message.refusal for _, message in told) and node.exit_code is None
