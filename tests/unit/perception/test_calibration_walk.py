"""docs/guide/endoscope/calibration.md, read and done line by line on rendered views."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.perception.walk_recording import record_walk, rests_of
from helpers.results.perception_results import PAGE
from helpers.sim import board_bench
from surg_cli.host import paths
from surg_core.camera_file import load_camera
from surg_perception.calibration.chain_steps import chain_error
from surg_perception.calibration.small_motions import difference
from surg_sim.physics.endoscope_rig import camera_poses
from surg_sim.physics.patient_settings import find_setting
from surg_sim.physics.pose_error import with_base_error

GUIDE = paths.ROOT / "docs" / "guide" / "endoscope" / "calibration.md"
TRY = "Try it in the simulator"
SETTING = "phantom+unregistered+lens"
RUNNING = ("--live", "live", "teleop", "check-frames", "EPISODE")
"""Words of lines that need a running system: test_calibrate_live and test_unknown_cell_commands, or
a recording of one: `drift` sees the walk's own."""


def boxes(kind: str) -> list[tuple[str, list[str]]]:
    """(heading, lines) of each box of the page that is marked as ``kind``."""
    found = []
    heading = ""
    for part in re.split(r"(?m)^(?=## )|(?=^```)", GUIDE.read_text("utf-8"), flags=re.M):
        if match := re.match(r"## (.*)", part):
            heading = match[1]
        if match := re.match(rf"```{kind}\n(.*)", part, flags=re.S):
            found.append((heading, match[1].splitlines()))
    return found


def commands() -> list[list[str]]:
    """The page's shell lines as words: first those that make the folders, then the others."""
    lines = [(heading == TRY, line) for heading, box in boxes("sh") for line in box]
    ordered = [line for first, line in lines if first] + [
        line for first, line in lines if not first
    ]
    return [shlex.split(line, comments=True) for line in ordered]


def test_settings_on_the_page_exist_and_the_clamp_is_turned_by_what_it_states() -> None:
    text = " ".join(GUIDE.read_text("utf-8").split())
    names = sorted(set(re.findall(r"phantom(?:\+[a-z]+)+", text)))
    assert names == [SETTING, SETTING.replace("+lens", "+reclamped+lens")]
    stated = re.search(r"`\S*\+reclamped\+lens`, .*? turned the endoscope by (\d+)° in its", text)
    assert stated is not None
    errors = [find_setting(name).camera_error for name in names]
    assert errors[0] is not None and errors[1] is not None
    turn, _ = lengths(difference(errors[0].motion(), errors[1].motion()))
    assert turn == pytest.approx(float(stated[1]), abs=0.5)


def lengths(step: np.ndarray) -> tuple[float, float]:
    """Turn [deg] and shift [mm] of a step (6,)."""
    return float(np.degrees(np.linalg.norm(step[:3]))), float(1e3 * np.linalg.norm(step[3:]))


def walk(surg: Callable[..., int], cell: Path) -> None:
    """Do the lines that need no running system; every one must succeed."""
    done = 0
    for words in commands():
        if any(word in RUNNING for word in words):
            continue
        place = {"cells/my_cell": str(cell), "my_cell": str(cell)}
        words = [place.get(word, word) for word in words]
        if words[0] == "cp":
            copied_cell(cell.parent, "sim_two_arms").rename(cell)
        elif words[0] == "python3":
            assert board_bench.main(words[2:]) == 0, words
        else:
            assert surg(*words[1:]) == 0, words
        done += 1
    assert done >= 11


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.full
def test_the_page_calibrates_a_cell_with_unknown_errors(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    cell = tmp_path / "cells" / "my_cell"
    walk(surg, cell)
    capsys.readouterr()
    calibration = cell / "calibration"
    for step in ("stereo", "handeye", "bases", "check"):
        assert "80 mm" in (calibration / "views" / f"{step}.html").read_text("utf-8")
    assert (calibration / "board.yaml.previous").is_file()
    before = files(cell)
    assert surg("calibrate", cell, "handeye", "--from", "scope", "--dry-run") == 0
    assert files(cell) == before
    judge(cell)
    calibrated = surg_core.load_cell(cell)
    rests = [rest for folder in ("scope", "tip") for rest in rests_of(Path(folder), calibrated)]
    walked = record_walk(tmp_path / "walk", calibrated, rests)
    assert surg("calibrate", cell, "drift", "--from", walked) == 0
    assert "moved: " not in capsys.readouterr().out


def judge(cell: Path) -> None:
    """The last sentence of the page, by the truth that only the bench knows."""
    stated_by_cell = surg_core.load_cell(cell)
    built = with_base_error(stated_by_cell, find_setting(SETTING).base_error)
    true_base = np.array(built.arms["ECM"].X_WB_stated)
    error = find_setting(SETTING).camera_error
    assert error is not None
    X_FV = camera_poses(stated_by_cell.arms["ECM"])[0] @ error.motion()
    found = np.array(load_camera(cell / "calibration" / "camera_ECM.yaml").X_FV)
    turn, shift = lengths(difference(found, X_FV))
    base, _ = lengths(difference(np.array(stated_by_cell.arms["ECM"].X_WB), true_base))
    stated = 1e3 * chain_error(stated_by_cell).two_sigma
    PAGE.note(
        "the guide's steps, rendered",
        1,
        f"hand-eye {shift:.3f} mm, {turn:.3f}° off, base {base:.3f}° off; chain stated "
        f"{stated:.2f} mm",
    )
    assert shift <= 0.3 and turn <= 0.1 and base <= 0.2 and stated <= 1.0
