"""`surg reach`: where tips can go, checked by the chain, MuJoCo and finite differences."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.control.capsule_scene import FAR, CapsuleScene
from surg_cli.commands.arms import reach as command
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core.tip_reach import Reach, reach

CELL = paths.ROOT / "cells" / "sim_two_arms"


@pytest.fixture(scope="module")
def cell() -> surg_core.Cell:
    return surg_core.load_cell(CELL)


@pytest.fixture(scope="module")
def found(cell: surg_core.Cell) -> Reach:
    return reach(cell, "PSM1")


def samples(found: Reach, n: int, seed: int = 1) -> list[tuple[int, ...]]:
    """Places that the tip reaches."""
    places = np.argwhere(found.reached)
    chosen = np.random.default_rng(seed).choice(len(places), n, replace=False)
    return [tuple(places[i]) for i in chosen]


def test_the_joints_put_the_tip_there_with_the_shaft_through_the_trocar(
    cell: surg_core.Cell, found: Reach
) -> None:
    arm = cell.arms["PSM1"]
    p_BRcm, X_home = np.asarray(arm.trocar.p_BRcm), np.asarray(arm.chain.forward(arm.robot.home))
    s_home = X_home[:3, :3] @ np.asarray(arm.tool.s_F)
    for at in samples(found, 300):
        X = np.asarray(arm.chain.forward(found.q[at]))
        state = surg_core.shaft_state(X, arm.tool.s_F, arm.tool.p_FTip, p_BRcm)
        assert np.linalg.norm(state.e) < 1e-4
        assert state.depth == pytest.approx(found.depths[at[2]], abs=1e-4)
        tilt = np.arccos(np.clip(np.asarray(state.s) @ s_home, -1.0, 1.0))
        assert tilt == pytest.approx(found.tilts[at[0]], abs=1e-3)


def test_the_fastest_tip_is_that_of_finite_differences(cell: surg_core.Cell, found: Reach) -> None:
    arm, rng = cell.arms["PSM1"], np.random.default_rng(2)
    p_BRcm, n = np.asarray(arm.trocar.p_BRcm), arm.chain.dof
    for at in samples(found, 40):
        rows = np.zeros((6, n))  # of the tip, the deviation from the pivot, and the roll
        omega = np.asarray(arm.chain.jacobian(found.q[at]))[3:]
        for i in range(n):
            ends = []
            for sign in (1.0, -1.0):
                q = found.q[at] + sign * 1e-6 * np.eye(n)[i]
                X = np.asarray(arm.chain.forward(q))
                state = surg_core.shaft_state(X, arm.tool.s_F, arm.tool.p_FTip, p_BRcm)
                ends.append(np.concatenate([state.p_BTip, state.e]))
            s = np.asarray(state.s)
            u = np.cross(s, [1.0, 0.0, 0.0])
            change = (ends[0] - ends[1]) / 2e-6
            rows[:, i] = [*change[:3], change[3:] @ u, change[3:] @ np.cross(s, u), omega[:, i] @ s]
        v = rng.normal(size=(3, 2000))
        v /= np.linalg.norm(v, axis=0)
        qd = np.linalg.solve(rows, np.vstack([v, np.zeros((3, 2000))]))
        fastest = np.max(np.abs(qd) / np.asarray(arm.robot.velocity)[:, None])
        assert 0.95 < fastest * found.speed[at] < 1.0 + 1e-3


def test_the_clearance_is_that_of_mujoco(cell: surg_core.Cell, found: Reach) -> None:
    scene, home = CapsuleScene(list(cell.arms.values())), np.asarray(cell.arms["ECM"].robot.home)
    compared = 0
    for at in samples(found, 200):
        apart = scene.distance(found.q[at], home)
        if 0.0 < apart < FAR:
            assert found.clearance[at] == pytest.approx(apart, abs=1e-6)
            compared += 1
    assert compared > 100


def test_a_tighter_cone_is_a_smaller_workspace(cell: surg_core.Cell, found: Reach) -> None:
    assert found.tilts[-1] == pytest.approx(cell.arms["PSM1"].limits.cone)
    assert 0.9 < found.share(found.reached) < 1.0
    assert found.share(found.free) < found.share(found.reached)
    assert found.full_to(found.free) < found.full_to(found.reached) < found.tilts[-1]


# --- the command ----------------------------------------------------------------------------------


def options(cell: Path | str, out: Path, arm: str | None = None) -> argparse.Namespace:
    return argparse.Namespace(cell=str(cell), out=out, arm=arm)


def test_the_command_tells_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(options("sim_ur5e", tmp_path / "out"), "reach") == 0
    said = capsys.readouterr().out
    assert "nothing near" in said
    assert (tmp_path / "out" / "reach.png").stat().st_size > 10_000


def test_an_arm_too_close_at_home_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(tmp_path, "clearance:\n  distance: 0.2  # m\n")
    assert command.main(options(folder, tmp_path / "out", "PSM1"), "reach") == 1
    assert "closer than 200 mm at home" in capsys.readouterr().out


def test_what_cannot_be_answered_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CliError, match="no such arm; allowed: PSM1, ECM"):
        command.main(options(CELL, tmp_path / "out", "PSM2"), "reach")
    folder = copy(tmp_path)
    trocar = folder / "calibration" / "trocar_PSM1.yaml"
    text = trocar.read_text()
    trocar.unlink()
    with pytest.raises(CliError, match="trocar_PSM1"):
        command.main(options(folder, tmp_path / "out"), "reach")
    lines = [
        "point: [0.5, 0.5, 0.5]" if line.startswith("point:") else line
        for line in text.splitlines()
    ]
    trocar.write_text("\n".join(lines) + "\n")
    with pytest.raises(CliError, match="beside its trocar"):
        command.main(options(folder, tmp_path / "out"), "reach")


def copy(folder: Path, more: str = "") -> Path:
    """The two-arm cell elsewhere, with more in its cell.yaml."""
    made = folder / "cell"
    shutil.copytree(CELL, made)
    text = (CELL / "cell.yaml").read_text().replace("../../src", str(paths.ROOT / "src"))
    (made / "cell.yaml").write_text(text + more)
    return made
