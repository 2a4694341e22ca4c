"""A wrong calibration is invisible to the controller; the calibration routine removes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.control.miscalibration import run, taught_at_home, tool_of, wrong_tool
from helpers.results.results_page import ResultsPage
from surg_cli.host import paths
from surg_core import calibration
from surg_core.reading.calibration_recording import read_recording
from surg_sim.physics.calibration_bench import Bench
from surg_sim.physics.trocar import shaft_in_flange

WRONG, AFTER = "1 mm, 0.5° wrong", "after the routine"
PAGE = ResultsPage("calibration.md")


def errors(arm: surg_core.Arm, tool: surg_core.ToolCalibration) -> tuple[float, float]:
    """Of tip [mm] and axis [deg] against the true tool."""
    p_FTip, s_F = shaft_in_flange(arm)
    sine = float(np.linalg.norm(np.cross(tool.s_F, s_F)))
    return 1e3 * float(np.linalg.norm(tool.p_FTip - p_FTip)), float(np.degrees(np.arcsin(sine)))


@pytest.mark.parametrize("name", ["sim_ur5e", pytest.param("sim_panda", marks=pytest.mark.full)])
def test_the_routine_brings_the_true_deviation_below_300_um(
    name: str, tmp_path: Path, full: bool
) -> None:
    cell = surg_core.load_cell(paths.ROOT / "cells" / name)
    arm = cell.arms["PSM1"]
    runs, seconds = (5, 10.0) if full else (1, 5.0)
    found: dict[str, list[tuple[surg_core.ToolCalibration, object]]] = {}
    p_FTip, s_F = shaft_in_flange(arm)
    exact = tool_of(s_F, p_FTip)
    found["exact"] = [(exact, run(cell, exact, arm.trocar.p_BRcm, seconds))]
    for seed in range(runs):
        wrong = wrong_tool(arm, np.random.default_rng(1000 + seed))
        deviation = run(cell, wrong, taught_at_home(arm, wrong), seconds)
        found.setdefault(WRONG, []).append((wrong, deviation))

        recording_file = tmp_path / f"{seed}.csv"
        Bench(cell, seed).record(recording_file, ("tip", "roll", "trocar"))
        recording = read_recording(recording_file, arm.chain, arm.robot.joint_names)
        tool = calibration.solve_tool(recording, "2026-11-21").tool
        trocar = calibration.solve_trocar(recording, tool, "2026-11-21").trocar
        deviation = run(cell, tool, trocar.p_BRcm, seconds)
        found.setdefault(AFTER, []).append((tool, deviation))
    figures = {}
    for what, members in found.items():
        kinematic = np.concatenate([d.kinematic for _, d in members]) * 1e3
        true = np.concatenate([d.true for _, d in members]) * 1e3
        tip, axis = np.max([errors(arm, tool) for tool, _ in members], axis=0)
        figures[what] = (kinematic, true)
        said = f"{kinematic.mean():.3f} / {kinematic.max():.3f} | {true.mean():.3f} / "
        said += f"{true.max():.3f} | {tip:.3f} | {axis:.3f}"
        PAGE.note(f"{arm.robot.name}, {what}", len(members), said)
    kinematic, true = figures[WRONG]
    assert kinematic.max() < 0.1, "the controller sees nothing of it"
    assert true.max() > 10 * kinematic.max()
    assert true.max() > 1.5
    kinematic, true = figures[AFTER]
    assert true.max() < 0.3
    assert figures["exact"][1].max() < 0.1


def test_the_routine_refuses_a_trocar_recorded_with_a_tool_that_is_far_off(
    tmp_path: Path,
) -> None:
    """Two degrees of axis error: the shafts do not meet in one point, and the error says why."""
    cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
    arm = cell.arms["PSM1"]
    p_FTip, s_F = shaft_in_flange(arm)
    Bench(cell, 5).record(tmp_path / "r.csv", ("trocar",))
    recording = read_recording(tmp_path / "r.csv", arm.chain, arm.robot.joint_names)
    leaning = s_F + np.array([0.035, 0.0, 0.0])
    wrong = tool_of(leaning / np.linalg.norm(leaning), p_FTip)
    with pytest.raises(surg_core.CalibrationError, match="tool is calibrated wrongly"):
        calibration.solve_trocar(recording, wrong, "2026-11-21")
