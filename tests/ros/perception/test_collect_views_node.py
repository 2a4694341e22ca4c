"""The collector of views on topics: what is missing is said to the person."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rospy
from sensor_msgs.msg import Image, JointState

import surg_core
from helpers.endoscope_files import copied_cell, write_endoscope
from helpers.graph.ros import RosGraph
from helpers.sim.board_views import BOARD
from surg_core.transforms import FloatArray
from surg_msgs.msg import CalibrationRequest
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.result_files import Origin
from surg_perception.collecting import collect_views_node
from surg_perception.collecting.collect_views_node import CollectViews
from surg_perception.collecting.collector import Step
from surg_perception.collecting.live_calibration import LiveCalibration

pytestmark = pytest.mark.ros


@pytest.fixture
def node(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[CollectViews]:
    """Of a cell with measured lenses, that waits for half a second only."""
    monkeypatch.setattr(collect_views_node, "SILENT_S", 0.5)
    folder = copied_cell(tmp_path)
    write_endoscope(folder / "calibration", "ECM")
    write_board(folder / "calibration" / "board.yaml", BOARD)
    made = CollectViews(
        LiveCalibration(
            surg_core.load_cell(folder),
            lambda step: tmp_path / step.value,
            lambda step, path: Origin("live", "2026-11-23", "simulated"),
        )
    )
    yield made
    made.close()


class Endoscope:
    """Publishes grey pictures of the eyes that it has."""

    def __init__(self, *eyes: str, apart: float = 0.0, encoding: str = "mono8") -> None:
        self._apart, self._encoding = apart, encoding
        self._out = [
            rospy.Publisher(f"/endoscope/{eye}/image_raw", Image, queue_size=1) for eye in eyes
        ]

    def show(self) -> None:
        now = rospy.get_time()
        for number, out in enumerate(self._out):
            picture = np.full((48, 64), 90, np.uint8).tobytes()
            image = Image(height=48, width=64, step=64, encoding=self._encoding, data=picture)
            image.header.stamp = rospy.Time.from_sec(now + number * self._apart)
            out.publish(image)


def hint(node: CollectViews, wanted: str, show: Callable[[], None] = lambda: None) -> None:
    """Turn until the person is told so."""
    end, told = time.monotonic() + 20.0, ""
    while time.monotonic() < end:
        show()
        told = node.turn(0.05).hint
        if wanted in told:
            return
    raise AssertionError(f"{wanted!r} is not in {told!r}")


def test_an_endoscope_that_is_not_there_is_named(node: CollectViews) -> None:
    node.start(Step.STEREO)
    both = "No pictures on /endoscope/left/image_raw and /endoscope/right/image_raw."
    hint(node, both)
    hint(node, "No pictures on /endoscope/right/image_raw.", Endoscope("left").show)


def test_eyes_of_different_times_and_another_encoding_are_said(node: CollectViews) -> None:
    node.start(Step.STEREO)
    hint(node, "its eyes have different stamps", Endoscope("left", "right", apart=0.01).show)
    hint(
        node, "Pictures are 'bayer_rggb8'", Endoscope("left", "right", encoding="bayer_rggb8").show
    )
    hint(node, "the left eye does not see the board", Endoscope("left", "right").show)


def test_one_eye_suffices_where_the_left_lens_alone_is_measured(
    node: CollectViews, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node._live, "left_only", True)
    for name in ("endoscope_right", "endoscope_stereo"):
        (node._live.cell.folder / "calibration" / f"{name}.yaml").unlink()
    node.start(Step.STEREO)
    hint(node, "the left eye does not see the board", Endoscope("left").show)


def test_silent_joints_are_named_and_what_they_say_is_judged(node: CollectViews) -> None:
    node.start(Step.HANDEYE)
    scope, arm = Endoscope("left", "right"), node._live.arm
    assert arm is not None
    hint(node, "ECM states no joints (/ECM/robot/measured_js).", scope.show)
    out = rospy.Publisher("/ECM/robot/measured_js", JointState, queue_size=10)
    home: FloatArray = np.array(arm.robot.home)

    def both() -> None:
        state = JointState(name=list(arm.robot.joint_names), position=list(home))
        state.header.stamp = rospy.Time.now()
        out.publish(state)
        scope.show()

    hint(node, "does not see the board", both)


def test_a_request_that_cannot_be_met_says_why(node: CollectViews) -> None:
    (node._live.cell.folder / "calibration" / "board.yaml").unlink()
    ask = rospy.Publisher("/calibrate/request", CalibrationRequest, queue_size=1)
    request = CalibrationRequest(request=CalibrationRequest.START_STEREO)
    hint(node, "Not started: ", lambda: ask.publish(request))
