"""Show: check-frames before and after the calibration of an unknown cell, by `./surg` commands.

Base, camera and lens are those of a setting; the commands know the cell's files only. The graph
runs in lock-step, so that a busy machine changes nothing.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.endoscope_files import copied_cell
from helpers.graph.surg import surg
from helpers.results.perception_results import PAGE
from helpers.sim import board_bench

pytestmark = [pytest.mark.ros, pytest.mark.full]

UNKNOWN = "phantom+unregistered+lens"
RECLAMPED = "phantom+unregistered+reclamped+lens"
STEPS = (("stereo", "stereo"), ("handeye", "handeye"), ("bases", "touch"))


def calibrate(cell: Path, folder: Path) -> None:
    """The whole chain, each step by its command, on the pictures of the bench."""
    done = surg("calibrate", cell, "board", "--to", folder / "board.png")
    assert done.returncode == 0, done.stderr
    for step, views in STEPS:
        words = [cell, folder / "board.png", folder / views, "--step", views, "--setting", UNKNOWN]
        assert board_bench.main([str(word) for word in words]) == 0
        by = ("--by", "touch") if step == "bases" else ()
        done = surg("calibrate", cell, step, *by, "--from", folder / views)
        assert done.returncode == 0, done.stderr
        print(done.stdout)


def checked(cell: Path, out: Path, setting: str) -> tuple[int, dict[str, Any]]:
    """The exit code of check-frames and its verdict."""
    done = surg("check-frames", cell, "--out", out, "--setting", setting, timeout_s=900.0)
    file = out / "check_frames.json"
    assert file.is_file(), done.stdout + done.stderr
    found = json.loads(file.read_text("utf-8"))
    print(setting, done.returncode, found["outcome"], found["angle_rad"], found["text"])
    return done.returncode, found


def test_check_frames_before_and_after_the_chain(tmp_path: Path) -> None:
    cell = copied_cell(tmp_path, "sim_two_arms")
    _, before = checked(cell, tmp_path / "before", UNKNOWN)
    calibrate(cell, tmp_path)
    passed, after = checked(cell, tmp_path / "after", UNKNOWN)
    failed, turned = checked(cell, tmp_path / "turned", RECLAMPED)
    angles = [
        f"{np.degrees(v['angle_rad']):.1f}° ({v['outcome']})" for v in (before, after, turned)
    ]
    PAGE.note(
        "./surg check-frames, base 2°, camera 4° and lens unknown",
        1,
        f"before {angles[0]}, after the chain {angles[1]}, then turned by 12° {angles[2]}",
    )
    assert passed == 0 and after["outcome"] == "pass"
    assert failed == 1 and turned["outcome"] == "fail"


def test_an_unknown_setting_is_refused_with_those_that_exist() -> None:
    done = surg("check-frames", "sim_two_arms", "--setting", "phantom+unregisterd")
    assert done.returncode == 2 and "unregistered" in done.stderr
