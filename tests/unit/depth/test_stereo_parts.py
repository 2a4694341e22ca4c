"""What the node ``/eyes`` is made of: parameters, joints at a time, messages, options of `up`."""

from __future__ import annotations

import argparse
import io

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from helpers.endoscope_files import copied_cell, lens
from surg_cli.commands import teleop, up
from surg_cli.graph import running
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core import ConfigError, axis_angle_to_matrix
from surg_perception.marks.mark_projection import PictureMark
from surg_perception.stereo import stereo_messages_node as messages
from surg_perception.stereo.joint_history import KEPT_NS, MOST_GAP_NS, JointHistory
from surg_perception.stereo.live_marks_node import message_of
from surg_perception.stereo.stereo_parameters import StereoSettings
from surg_ros.params import ParamError, read

MS = 1_000_000


def test_joints_at_the_time_of_a_picture() -> None:
    history = JointHistory()
    assert history.at(0) is None
    for k in range(10):
        history.add(k * 10 * MS, np.array([0.1 * k, -0.2 * k]))
    np.testing.assert_allclose(history.at(44 * MS), [0.44, -0.88])
    np.testing.assert_allclose(history.at(0), [0.0, 0.0])
    np.testing.assert_allclose(history.at(90 * MS + MOST_GAP_NS), [0.9, -1.8])
    assert history.at(91 * MS + MOST_GAP_NS) is None, "the arm fell silent: no mark"
    history.add(500 * MS, np.array([0.0, 0.0]))
    assert history.at(300 * MS) is None, "nothing is known in a gap"


def test_joints_that_are_no_numbers_or_come_late_are_ignored() -> None:
    history = JointHistory()
    history.add(10 * MS, np.array([1.0]))
    history.add(20 * MS, np.array([np.nan]))
    history.add(5 * MS, np.array([7.0]))
    history.add(30 * MS, np.array([1.0, 2.0]))
    np.testing.assert_allclose(history.at(12 * MS), [1.0])
    history.add(5000 * MS, np.array([3.0]))
    history.add(5000 * MS - 2 * KEPT_NS, np.array([4.0]))  # the clock was set back
    np.testing.assert_allclose(history.at(5000 * MS - 2 * KEPT_NS), [4.0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"rate": 0.0}, "parameter ~rate is 0.0"),
        ({"near": 0.3, "far": 0.1}, "less than ~far"),
        ({"marks": True}, "the folder of the cell, with ~marks or ~drift"),
        ({"niceness": -5}, "parameter ~niceness"),
        ({"speed": 1}, "parameter ~speed is unknown"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(given: dict, said: str) -> None:
    with pytest.raises(ParamError) as refused:
        read(StereoSettings, given)
    assert said in str(refused.value)


def test_pictures_are_read_whatever_their_order_and_step() -> None:
    picture = np.arange(2 * 4 * 3, dtype=np.uint8).reshape(2, 4, 3)
    padded = np.zeros((2, 16), np.uint8)
    padded[:, :12] = picture.reshape(2, 12)
    rgb = Image(height=2, width=4, step=16, encoding="rgb8", data=padded.tobytes())
    np.testing.assert_array_equal(messages.picture_of(rgb), picture)
    rgb.encoding = "bgr8"
    np.testing.assert_array_equal(messages.picture_of(rgb), picture[..., ::-1])
    again = messages.image_of(Header(), picture)
    np.testing.assert_array_equal(messages.picture_of(again), picture)


@pytest.mark.parametrize(
    "message",
    [
        Image(height=2, width=4, step=12, encoding="mono8", data=bytes(24)),
        Image(height=2, width=4, step=12, encoding="rgb8", data=bytes(20)),
        Image(height=2, width=4, step=8, encoding="rgb8", data=bytes(24)),
        Image(height=0, width=4, step=12, encoding="rgb8", data=b""),
    ],
)
def test_a_picture_that_is_none_is_an_error(message: Image) -> None:
    with pytest.raises(ValueError, match="picture"):
        messages.picture_of(message)


def test_the_lens_of_a_camera_info() -> None:
    good = lens("left")
    info = CameraInfo(width=640, height=480, distortion_model="plumb_bob", D=good.D.tolist())
    info.K, info.R, info.P = (m.ravel().tolist() for m in (good.K, good.R, good.P))
    found = messages.lens_of_message("endoscope_left", info)
    np.testing.assert_array_equal(found.P, good.P)
    info.K = [0.0] * 9
    with pytest.raises(ConfigError, match=r"\./surg calibrate CELL stereo"):
        messages.lens_of_message("endoscope_left", info)


def test_points_stand_in_the_left_eyes_frame() -> None:
    R = axis_angle_to_matrix(np.array([0.0, 1.0, 0.0]), 0.1)
    points = np.full((2, 2, 3), np.nan, np.float32)
    points[0, 1], points[1, 0] = [0.01, 0.0, 0.08], [0.0, 0.02, 0.06]
    colours = np.zeros((2, 2, 3), np.uint8)
    colours[0, 1] = [255, 128, 1]
    cloud = messages.cloud_of(Header(), points, colours, R)
    rows = np.frombuffer(cloud.data, [("p", "<f4", 3), ("rgb", "<u4")])
    assert (cloud.width, cloud.height, len(rows)) == (2, 1, 2)
    # R takes the left eye's axes to the rectified ones.
    np.testing.assert_allclose(R @ rows["p"][0], [0.01, 0.0, 0.08], atol=1e-8)
    assert rows["rgb"][0] == 0xFF8001


def test_marks_as_a_message_left_eye_first() -> None:
    turned = np.array([[5.0, 3.0], [3.0, 5.0]])  # eigenvalues 8 and 2, at 45 degrees
    left = [PictureMark("A", "tip", np.array([[10.123, 20.456]]), turned)]
    right = [PictureMark("A", "shaft", np.array([[1.0, 2.0], [np.nan, np.nan]]))]
    info = CameraInfo(width=640, height=480, header=Header(frame_id="endoscope_left"))
    found = message_of(info, [left, right])
    assert (found.width, found.height, found.header) == (640, 480, info.header)
    tip, shaft = found.marks
    assert (tip.eye, tip.name, tip.x, tip.y) == ("left", "tip", [10.12], [20.46])
    long, short, angle = tip.ellipse
    assert (long, short) == pytest.approx((2 * 8**0.5, 2 * 2**0.5), abs=1e-3)
    assert abs(np.tan(angle) - 1.0) < 1e-3
    assert shaft.eye == "right" and shaft.ellipse == [] and np.isnan(shaft.y[1])
    buffer = io.BytesIO()
    found.serialize(buffer)
    assert len(buffer.getvalue()) < 500
    assert len(message_of(info, [left]).marks) == 1, "one eye"


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    parser = argparse.ArgumentParser()
    up.add_arguments(parser, "up")
    up.main(parser.parse_args([*words, "--print"]), "up")
    return [line for line in capsys.readouterr().out.splitlines() if "stereo_depth_node.py" in line]


def test_up_starts_the_node_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys, "sim_two_arms", "--cameras", "stereo") == []
    (line,) = printed(capsys, "sim_two_arms", "--cameras", "depth")
    assert "_depth:=true" in line and "_marks:=false" in line and "_cell" not in line
    (line,) = printed(capsys, "sim_two_arms", "--cameras", "marks")
    assert "_depth:=false" in line and "_marks:=true" in line and "sim_two_arms" in line


def test_teleop_has_the_options_of_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def options(*words: str) -> argparse.Namespace:
        parser = argparse.ArgumentParser()
        teleop.add_arguments(parser, "teleop")
        return parser.parse_args(["sim_two_arms", "--task", "none", *words])

    assert teleop._plan(options()).eyes is None
    plan = teleop._plan(options("--cameras", "marks"))
    assert plan.cameras == ("left", "right") and plan.eyes is not None
    assert plan.eyes["marks"] is True and plan.eyes["depth"] is False
    # Beside a system that runs there is nobody to start the node in.
    there = running.System(11311, 1, 1, "up", str(paths.CELLS / "sim_two_arms"), "")
    monkeypatch.setattr(running, "systems", lambda: [there])
    with pytest.raises(CliError, match=r"start that system with it: .*CELL --cameras depth"):
        teleop.main(options("--cameras", "depth"), "teleop")


def test_up_refuses_depth_without_two_eyes(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(CliError, match="--cameras depth: there are no pictures"):
        printed(capsys, "emulated_ur5e", "--cameras", "depth")
    cell = copied_cell(tmp_path, "sim_ur5e")
    text = (cell / "cell.yaml").read_text()
    (cell / "cell.yaml").write_text(
        text + "endoscope: {source: 'v4l2:/dev/video0', layout: mono}\n"
    )
    with pytest.raises(CliError, match="--cameras marks: the endoscope has one eye"):
        printed(capsys, str(cell), "--cameras", "marks")
