"""The board with a later OpenCV: drawn alike, and found in the same pixels, as by Debian's 4.6.

OpenCV 4.7 moved its ArUco module and renamed its functions. Both board sizes are tried: versions
differ in boards with an even number of rows.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.sim.board_views import BARREL, BOARD, bench
from helpers.tree import oracle_venv
from surg_perception.calibration.board import Board

pytestmark = pytest.mark.oracle

LATER = ("opencv-python-headless==4.11.0.86", "numpy==1.26.4", "PyYAML==6.0.2")
BOARDS = (BOARD, Board(9, 7, 0.005, "DICT_5X5_100"))
SCRIPT = """
import json, sys
import cv2
from surg_perception.calibration.board import Board
said = {"version": cv2.__version__, "found": [], "drawn": []}
for name, words, pictures in json.loads(sys.argv[1]):
    board = Board(*words)
    said["drawn"].append(board.picture(30).tolist())
    for file in pictures:
        picture = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
        found = board.find(picture)
        said["found"].append([found.ids.tolist(), found.pixels.tolist()])
    said["mirrored"] = board.why_not(picture[:, ::-1].copy())
    other = Board(board.columns, board.rows, board.square, "DICT_6X6_100")
    said["foreign"] = other.why_not(picture)
print(json.dumps(said))
"""


def test_a_later_opencv_draws_and_finds_the_same_board(tmp_path: Path) -> None:
    python = oracle_venv.python("opencv-4.11", [LATER], ("cv2", "numpy"))
    stand, asked, expected = bench(3, BARREL), [], []
    for number, board in enumerate(BOARDS):
        files = []
        if board == BOARD:
            pictures = [eye for view in stand.held_board(2) for eye in stand.pictures(view)]
        else:
            drawn = cv2.copyMakeBorder(board.picture(50), *[40] * 4, cv2.BORDER_CONSTANT, value=255)
            pictures = [cv2.GaussianBlur(drawn, (0, 0), 0.8)]
        for picture in pictures:
            file = tmp_path / f"{number}_{len(files)}.png"
            cv2.imwrite(str(file), picture)
            files.append(str(file))
            expected.append(board.find(picture))
        words = (board.columns, board.rows, board.square, board.dictionary)
        asked.append((number, words, files))
    done = subprocess.run(
        [str(python), "-c", SCRIPT, json.dumps(asked)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ},
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["version"] != cv2.__version__
    for board, drawn in zip(BOARDS, said["drawn"], strict=True):
        np.testing.assert_array_equal(drawn, board.picture(30))
    away = []
    for (ids, pixels), own in zip(said["found"], expected, strict=True):
        assert own is not None
        both = sorted(set(ids) & set(own.ids.tolist()))
        assert len(both) >= 0.95 * len(own.ids)
        theirs = np.array([pixels[ids.index(k)] for k in both])
        away.append(theirs - own.only(np.array(both)).pixels)
    off = np.abs(np.concatenate(away))
    print(f"{said['version']}: {len(off)} corners, largest difference {off.max():.4f} px")
    assert off.max() <= 0.05
    assert "mirrored" in said["mirrored"] and "DICT_5X5_100" in said["foreign"]
