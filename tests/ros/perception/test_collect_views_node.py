"""The collector of views on topics: what is missing is said to the person."""

from __future__ import annotations

import itertools
import threading
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
from surg_perception.collecting.base_moments_node import BaseMoments
from surg_perception.collecting.base_views import Moment
from surg_perception.collecting.collect_views_node import CollectViews
from surg_perception.collecting.collector import CalibrationStep
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
    node.start(CalibrationStep.STEREO)
    both = "No pictures on /endoscope/left/image_raw and /endoscope/right/image_raw."
    hint(node, both)
    hint(node, "No pictures on /endoscope/right/image_raw.", Endoscope("left").show)


def test_eyes_of_different_times_and_another_encoding_are_said(node: CollectViews) -> None:
    node.start(CalibrationStep.STEREO)
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
    node.start(CalibrationStep.STEREO)
    hint(node, "the left eye does not see the board", Endoscope("left").show)


def test_silent_joints_are_named_and_what_they_say_is_judged(node: CollectViews) -> None:
    node.start(CalibrationStep.HANDEYE)
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


def test_a_moment_of_both_eyes_and_both_arms(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    cell = surg_core.load_cell(copied_cell(tmp_path))
    moments = BaseMoments(cell, ("ECM", "PSM1"), 2)
    assert "no pictures on /endoscope/left/image_raw and" in said(moments.next(0.3))
    scope, ended = Endoscope("left", "right"), threading.Event()
    robots = {arm: cell.arms[arm].robot for arm in ("ECM", "PSM1")}
    out = {
        arm: rospy.Publisher(f"/{arm}/robot/measured_js", JointState, queue_size=10)
        for arm in robots
    }
    moving = {"PSM1": 0.0}
    speaking: set[str] = set()

    def publish() -> None:
        for count in itertools.count():
            if ended.wait(0.02):
                return
            for arm in tuple(speaking):
                q = np.array(robots[arm].home) + moving.get(arm, 0.0) * count
                state = JointState(name=list(robots[arm].joint_names), position=list(q))
                state.header.stamp = rospy.Time.now()
                out[arm].publish(state)
            scope.show()

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        until(lambda: "ECM states no joints" in said(moments.next()))
        speaking |= set(robots)
        until(lambda: isinstance(found := moments.next(), Moment) and at_rest(found) == {*robots})
        shown = moments.next()
        assert isinstance(shown, Moment) and len(shown.pair) == 2
        for arm, robot in robots.items():
            q = shown.joints[arm]
            if q is not None:  # a busy machine may leave a hole in the half second
                np.testing.assert_allclose(q, robot.home, atol=1e-9)
        moving["PSM1"] = 0.01
        until(lambda: isinstance(found := moments.next(), Moment) and at_rest(found) == {"ECM"})
    finally:
        ended.set()
        thread.join()
        moments.close()


def said(moment: Moment | str) -> str:
    return moment if isinstance(moment, str) else ""


def at_rest(moment: Moment) -> set[str]:
    return {arm for arm, q in moment.joints.items() if q is not None}


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not true():
        assert time.monotonic() < end
