"""check-frames takes no camera model that nobody has measured."""

import pytest

rospy = pytest.importorskip("rospy")

from sensor_msgs.msg import CameraInfo  # noqa: E402

from surg_teleop.frames.endoscope_pictures_node import EndoscopePictures  # noqa: E402


def test_a_focal_length_of_zero_is_no_lens() -> None:
    pictures = EndoscopePictures(())
    pictures.names = ("left",)
    pictures._infos = {"left": CameraInfo(width=640, height=480)}
    assert pictures.lens() is None
    pictures._infos = {"left": CameraInfo(K=[450.0, 0, 320, 0, 450, 240, 0, 0, 1])}
    lens = pictures.lens()
    assert lens is not None
    assert lens.f == 450.0
