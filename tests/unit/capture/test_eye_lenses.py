"""The camera model of a published picture comes from the cell's lens files, scaled, or is empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers import endoscope_files
from surg_core import ConfigError, lens_file
from surg_perception.capture import eye_lenses

BOTH = ("left", "right")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for eye in BOTH:
        lens_file.write_lens(tmp_path / f"endoscope_{eye}.yaml", endoscope_files.lens(eye))
    return tmp_path


def test_without_a_cell_or_files_nobody_has_measured_a_lens(tmp_path: Path) -> None:
    assert eye_lenses.load(None, BOTH) == {}
    assert eye_lenses.load(tmp_path, BOTH) == {}


def test_a_smaller_picture_of_the_same_aspect_has_the_scaled_lens(folder: Path) -> None:
    lenses = eye_lenses.load(folder, BOTH)
    for eye in BOTH:
        found, problem = eye_lenses.fitted(lenses[eye], 320, 240)
        assert problem == ""
        assert found is not None
        assert found.K[0, 0] == pytest.approx(224.0)  # 0.7 of the width
        assert found.K[0, 2] == pytest.approx((319.3 + 0.5) / 2 - 0.5)
        assert np.array_equal(found.D, lenses[eye].D)
    assert eye_lenses.fitted(None, 320, 240) == (None, "")


def test_a_picture_of_another_aspect_has_no_lens_and_a_cure(folder: Path) -> None:
    found, problem = eye_lenses.fitted(eye_lenses.load(folder, BOTH)["left"], 960, 540)
    assert found is None
    for word in ("endoscope_left", "640 x 480", "960 x 540", "./surg calibrate"):
        assert word in problem


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda left, right: right.unlink(), "endoscope_right.yaml: is missing"),
        (lambda left, right: right.write_bytes(left.read_bytes()), "no baseline"),
        (lambda left, right: left.write_text("image_width: 640\n"), "endoscope_left.yaml"),
    ],
    ids=["missing", "same", "broken"],
)
def test_files_that_are_no_pair_are_refused(folder: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    change(*(folder / f"endoscope_{eye}.yaml" for eye in BOTH))
    with pytest.raises(ConfigError, match=words):
        eye_lenses.load(folder, BOTH)


def test_camera_info_is_the_lens_or_zero() -> None:
    pytest.importorskip("rospy")
    from surg_perception.capture.capture_node import camera_info

    lens = endoscope_files.lens("right")
    info = camera_info("right", lens, 640, 480)
    assert info.header.frame_id == "endoscope_right"
    assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
    assert np.array_equal(np.reshape(info.P, (3, 4)), lens.P)
    assert np.array_equal(info.D, lens.D)
    assert set(camera_info("left", None, 640, 480).K) == {0.0}
