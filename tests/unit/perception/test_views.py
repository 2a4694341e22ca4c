"""A folder of views: what is read, what is left out with a reason, what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.sim.board_views import BOARD
from surg_perception.calibration import evidence
from surg_perception.calibration.board import BoardError
from surg_perception.calibration.steps import enough, find_board
from surg_perception.calibration.views import ViewsError, read_views

HEADER = "view,stamp,touch,A/j1,A/j2"
PICTURE = cv2.copyMakeBorder(BOARD.picture(30), 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two views of the board."""
    rows = ["000,1.0,,0.1,0.2", "001,2.0,7,0.3,0.4"]
    (tmp_path / "views.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    for name in ("000", "001"):
        for eye in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"{name}_{eye}.png"), PICTURE)
    return tmp_path


def rewrite(folder: Path, *lines: str) -> None:
    (folder / "views.csv").write_text("\n".join(lines) + "\n")


def test_views_have_corners_joints_and_touches(folder: Path) -> None:
    views = read_views(folder, BOARD)
    assert [view.name for view in views.with_board()] == ["000", "001"]
    assert views.size == (PICTURE.shape[1], PICTURE.shape[0])
    first, second = views.views
    assert (first.touch, second.touch) == (None, 7)
    np.testing.assert_array_equal(second.of_arm("A", ("j2", "j1")), [0.4, 0.3])
    with pytest.raises(ViewsError, match="B/j1"):
        first.of_arm("B", ("j1",))


def test_a_view_without_the_board_is_left_out_with_its_reason(folder: Path) -> None:
    cv2.imwrite(str(folder / "000_right.png"), PICTURE[:, ::-1])
    (folder / "001_left.png").unlink()
    views = read_views(folder, BOARD)
    assert views.with_board() == [] and len(views.skipped) == 2
    assert any("mirrored" in reason for reason in views.skipped)
    with pytest.raises(evidence.Refused) as refused:
        enough(views, 1)
    assert "mirrored" in refused.value.reasons[0]


def test_the_pixels_of_a_tip_are_read(folder: Path) -> None:
    tip = ",tip_left_x,tip_left_y,tip_right_x,tip_right_y"
    rewrite(folder, HEADER + tip, "000,1.0,,0.1,0.2,10,20,8,20", "001,2.0,,0.3,0.4,,,,")
    first, second = read_views(folder, BOARD).views
    np.testing.assert_array_equal(first.tip, [10.0, 20.0, 8.0, 20.0])
    assert second.tip is None


BAD = {
    "no rows": [HEADER],
    "no column of stamps": ["view,A/j1", "000,0.1"],
    "a stamp that is no number": [HEADER, "000,now,,0.1,0.2"],
    "a joint that is not finite": [HEADER, "000,1.0,,nan,0.2"],
    "a touch beyond the board": [HEADER, "000,1.0,70,0.1,0.2"],
    "a name that leaves the folder": [HEADER, "../000,1.0,,0.1,0.2"],
    "a missing value": [HEADER, "000,1.0,,0.1"],
    "a value too many": [HEADER, "000,1.0,,0.1,0.2,0.3"],
    "half a tip": [HEADER + ",tip_left_x,tip_left_y", "000,1.0,,0.1,0.2,3,4"],
    "no picture at all": [HEADER, "999,1.0,,0.1,0.2"],
}


@pytest.mark.parametrize("what", BAD)
def test_a_table_that_cannot_be_used_is_refused(what: str, folder: Path) -> None:
    rewrite(folder, *BAD[what])
    with pytest.raises(ViewsError, match=str(folder)):
        read_views(folder, BOARD)


def test_pictures_of_two_sizes_are_refused(folder: Path) -> None:
    cv2.imwrite(str(folder / "001_right.png"), PICTURE[:-10])
    with pytest.raises(ViewsError, match="one size"):
        read_views(folder, BOARD)


def test_a_file_that_is_no_picture_is_refused(folder: Path) -> None:
    (folder / "001_right.png").write_bytes(b"not a picture")
    with pytest.raises(ViewsError, match="001_right"):
        read_views(folder, BOARD)


def test_a_folder_that_is_not_there_is_refused(folder: Path) -> None:
    shutil.rmtree(folder)
    with pytest.raises(ViewsError, match="cannot be read"):
        read_views(folder, BOARD)


def test_a_board_that_nobody_states_is_asked_for(folder: Path) -> None:
    with pytest.raises(BoardError, match="no board"):
        find_board(folder / "calibration", folder)
