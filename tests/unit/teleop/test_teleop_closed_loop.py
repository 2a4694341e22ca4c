"""The bundled motion through operator and core controller on every arm, with servo lag."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.control.third_arm import write_third_arm
from surg_cli.host import paths
from surg_description.make_cell import make_cell
from surg_teleop.playback.motion_player import Mode, PlayerStage

pytest.importorskip("surg_core", reason="surg_core is not built")

from helpers.control.lagging_arm import Run, play

DESCRIPTION = paths.ROOT / "src/surg_description"
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
SECONDS = None if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 8.0


def cell_of(name: str, folder: Path) -> Path:
    bundled = paths.ROOT / f"cells/sim_{name}"
    if bundled.is_dir():
        return bundled
    robot = DESCRIPTION / f"robots/{name}.yaml"
    if name == "third_arm":
        robot = write_third_arm(folder / "third", DESCRIPTION / "robots/ur5e.yaml")
    return make_cell(robot, folder / "cell", DESCRIPTION / "instruments/grasper.yaml")


def describe(run: Run) -> str:
    return (
        f"rcm mean {1e3 * run.rcm_error.mean():.4f} max {1e3 * run.rcm_error.max():.4f} mm, "
        f"tip rms {1e3 * np.sqrt(np.mean(run.tip_error**2)):.3f} mm, lag {1e3 * run.lag:.0f} ms, "
        f"unscaled {run.unscaled:.4f} {sorted(run.limited_by)}"
    )


ROBOTS = ("ur5e", "panda", "ur3e", "ur10e", "fr3", "xarm7", "third_arm")
QUICK = (
    *(("ur5e", mode) for mode in Mode),
    *(("panda", mode) for mode in Mode),
    ("third_arm", Mode.CARTESIAN),
    ("xarm7", Mode.SPHERICAL),
)
RUNS = [
    pytest.param(*each, marks=[] if each in QUICK else pytest.mark.full)
    for each in itertools.product(ROBOTS, Mode)
]


@pytest.mark.parametrize(("name", "mode"), RUNS)
def test_bundled_motion_meets_the_limits(name: str, mode: Mode, tmp_path: Path) -> None:
    run = play(cell_of(name, tmp_path), BUNDLED, mode, SECONDS)
    print(f"{name} {mode.value}: {describe(run)}")
    assert run.stage is PlayerStage.DONE, run.reason
    assert run.refused == 0
    assert run.unscaled >= 0.98
    assert run.rcm_error.mean() <= 0.03e-3
    assert run.rcm_error.max() <= 0.3e-3
    assert np.sqrt(np.mean(run.tip_error**2)) <= 1e-3


@pytest.mark.parametrize(("feedback_gain", "holds"), [(-1.0, True), (0.0, False)])
def test_a_lag_nobody_knows_of_needs_the_feedback(
    feedback_gain: float, holds: bool, tmp_path: Path
) -> None:
    """With link_lag 0 the velocity form predicts nothing; without feedback the pivot drifts."""
    robot = DESCRIPTION / "robots/ur5e.yaml"
    cell = make_cell(robot, tmp_path / "cell", DESCRIPTION / "instruments/grasper.yaml")
    (tmp_path / "cell/unaware.yaml").write_text(
        "format: surg_link/1\nname: unaware\nlink_timeout: 0.1\nlink_lag: 0\nacceleration: 1\n"
    )
    cell.write_text(cell.read_text().replace("link: simulator", "link: unaware.yaml"))
    run = play(cell, BUNDLED, Mode.CARTESIAN, 8.0, feedback_gain, surg_core.Law.VELOCITY)
    print(f"feedback {feedback_gain}: {describe(run)}")
    assert (run.rcm_error.max() <= 0.3e-3) == holds
