"""The steps of docs/guide/endoscope/calibration.md, on rendered views of an unknown cell."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.results.perception_results import PAGE
from surg_core.camera_file import load_camera
from surg_perception.calibration.base_steps import chain_error
from surg_perception.calibration.small_motions import difference
from surg_sim.looks import board_bench
from surg_sim.physics.endoscope_rig import camera_poses
from surg_sim.physics.patient_settings import find_setting
from surg_sim.physics.pose_error import with_base_error

SETTING = "phantom+unregistered+lens"


def lengths(step: np.ndarray) -> tuple[float, float]:
    """Turn [deg] and shift [mm] of a step (6,)."""
    return float(np.degrees(np.linalg.norm(step[:3]))), float(1e3 * np.linalg.norm(step[3:]))


@pytest.mark.full
def test_the_guide_calibrates_a_cell_with_unknown_errors(
    surg: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, board = copied_cell(tmp_path), tmp_path / "board.png"
    calibration = cell / "calibration"
    built = with_base_error(surg_core.load_cell(cell), find_setting(SETTING).base_error)
    true_base = np.array(built.arms["ECM"].X_WB_stated)
    assert surg("calibrate", cell, "board", "--out", board) == 0
    views = (("lenses", "stereo", 20), ("scope", "handeye", 15), ("tip", "touch", 16))
    for name, step, count in views:
        words = [cell, board, tmp_path / name, "--step", step, "--setting", SETTING]
        assert board_bench.main([*map(str, words), "--count", str(count)]) == 0
    assert surg("calibrate", cell, "stereo", "--from", tmp_path / "lenses") == 0
    assert surg("calibrate", cell, "handeye", "--from", tmp_path / "scope") == 0
    assert surg("calibrate", cell, "bases", "--by", "touch", "--from", tmp_path / "tip") == 0
    capsys.readouterr()
    assert surg("calibrate", cell, "check") == 0
    assert "joints and picture agree within" in capsys.readouterr().out
    believed = surg_core.load_cell(cell)
    error = find_setting(SETTING).camera_error
    assert error is not None
    X_FV = camera_poses(believed.arms["ECM"])[0] @ error.motion()
    found = np.array(load_camera(calibration / "camera_ECM.yaml").X_FV)
    turn, shift = lengths(difference(found, X_FV))
    base, _ = lengths(difference(np.array(believed.arms["ECM"].X_WB), true_base))
    stated = 1e3 * chain_error(believed).two_sigma
    PAGE.note(
        "the guide's steps, rendered",
        1,
        f"hand-eye {shift:.3f} mm, {turn:.3f}° off, base {base:.3f}° off; chain stated "
        f"{stated:.2f} mm",
    )
    assert shift <= 0.3 and turn <= 0.1 and base <= 0.2 and stated <= 1.0
