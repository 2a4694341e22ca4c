"""`./surg calibrate`: recordings in, calibration files out; nothing that was there is lost."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

import surg_core
import surg_core.calibration
from helpers.endoscope_files import copied_cell
from surg_cli import __main__ as cli
from surg_cli.commands import calibrate
from surg_cli.host.terminal import CliError
from surg_core.reading import calibration_recording
from surg_core.standstill import Standstill

DATE = "2026-11-21"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return copied_cell(tmp_path / "cells", "sim_ur5e")


def recording(path: Path, cell: Path, *, poses: bool = False, tip_mm: float = 1.0) -> Path:
    """An exact recording of a tool whose tip is `tip_mm` further out than the cell says."""
    arm = surg_core.load_cell(cell).arms["PSM1"]
    rng = np.random.default_rng(3)
    s_F, p_FTip = np.array(arm.tool.s_F), np.array(arm.tool.p_FTip)
    p_FTip = p_FTip + 1e-3 * tip_mm * s_F
    X0 = arm.chain.forward(arm.robot.home)
    fixed = X0[:3, :3] @ p_FTip + X0[:3, 3]
    columns = calibration_recording.POSE if poses else tuple(arm.robot.joint_names)
    lines = ["# a bench in the laboratory", ",".join(["motion", *columns])]
    for motion in ("tip", "roll", "trocar"):
        for k in range(8):
            R = X0[:3, :3] @ surg_core.axis_angle_to_matrix(s_F, rng.uniform(-1, 1))
            if motion != "roll":
                tilt = surg_core.axis_angle_to_matrix([math.cos(k), math.sin(k), 0], 0.3)
                R = tilt @ R
            X = np.eye(4)
            depth = 0.1 if motion == "trocar" else 0.0
            X[:3, :3], X[:3, 3] = R, fixed - R @ (p_FTip - depth * s_F)
            if poses:
                values = [*X[:3, 3], *surg_core.matrix_to_quaternion_xyzw(R)]
            else:
                values = list(inverse(arm, X))
            lines.append(",".join([motion, *(repr(float(value)) for value in values)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def inverse(arm: surg_core.Arm, X: np.ndarray) -> np.ndarray:
    q = np.array(arm.robot.home)
    for _ in range(50):
        now = arm.chain.forward(q)
        R = X[:3, :3] @ now[:3, :3].T
        w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        q = q + np.linalg.solve(arm.chain.jacobian(q), np.concatenate([X[:3, 3] - now[:3, 3], w]))
    np.testing.assert_allclose(arm.chain.forward(q), X, atol=1e-12)
    return q


@pytest.mark.parametrize("poses", [False, True])
def test_a_recording_becomes_the_cells_calibration(
    cell: Path,
    tmp_path: Path,
    poses: bool,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(calibrate, "today", lambda: DATE)
    source = recording(tmp_path / "bench.csv", cell, poses=poses)
    tool_file = cell / "calibration" / "tool_PSM1.yaml"
    before = tool_file.read_text()
    words = [str(cell), "tool", "--from", str(source)]
    command = ["calibrate", *words]
    ready([*command, "--dry-run"])
    assert tool_file.read_text() == before
    ready(command)
    said = capsys.readouterr().out
    assert "change 1.000 mm and 0.000 deg" in said
    assert str(tool_file) in said
    tool = surg_core.load_tool(tool_file)
    np.testing.assert_allclose(tool.p_FTip, [0.06, 0, 0.301], atol=1e-9)
    np.testing.assert_allclose(tool.s_F, [0, 0, 1], atol=1e-9)
    assert (tool.n, tool.date) == (16, DATE)
    assert tool.residual < 1e-9
    assert 1 < tool.condition < 30
    assert (cell / "calibration" / "tool_PSM1.yaml.previous").read_text() == before

    ready(["calibrate", str(cell), "trocar", "--from", str(source)])
    trocar = surg_core.load_cell(cell).arms["PSM1"].trocar
    arm = surg_core.load_cell(cell).arms["PSM1"]
    X0 = arm.chain.forward(arm.robot.home)
    np.testing.assert_allclose(trocar.p_BRcm, X0[:3, :3] @ tool.p_FTip + X0[:3, 3], atol=1e-8)
    assert sorted(p.name for p in (cell / "calibration").iterdir()) == [
        "tool_PSM1.yaml",
        "tool_PSM1.yaml.previous",
        "trocar_PSM1.yaml",
        "trocar_PSM1.yaml.previous",
    ], "no temporary file is left"


def ready(words: list[str]) -> None:
    """Runs a command in this process, as `./surg` would when everything is set up."""
    os.environ[cli.READY] = "1"
    assert cli.run(words) == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("motion,a,b\n", "the header is motion,a,b; needed is motion,shoulder_pan_joint"),
        ("{header}\ntip,1,2\n", ":2: 3 values; the header has 7"),
        ("{header}\nslide,0,0,0,0,0,0\n", ":2: motion 'slide' is unknown; allowed are tip, roll"),
        ("{header}\n#\n\ntip,0,0,0,x,0,0\n", ":4: wrist_1_joint: 'x' is not a finite number"),
        ("{header}\ntip,0,0,0,nan,0,0\n", "'nan' is not a finite number"),
        ("{header}\nroll,0,0,0,0,0,0\n", "no row of motion 'tip'"),
        ("{header}\ntip,0,0,0,0,0,0\n", "1 poses; at least 6 are needed"),
        ("{header}\n" + "tip,0,0,0,0,0,0\n" * 9, "condition number without bound"),
        ("motion,x,y,z,qx,qy,qz,qw\ntip,0,0,0,0,0,0,2\n", "the quaternion has length 2"),
    ],
)
def test_a_bad_recording_is_refused_and_the_cell_stays(
    cell: Path, tmp_path: Path, text: str, words: str
) -> None:
    names = surg_core.load_cell(cell).arms["PSM1"].robot.joint_names
    source = tmp_path / "bench.csv"
    source.write_text(text.replace("{header}", ",".join(["motion", *names])))
    before = {p.name: p.read_text() for p in (cell / "calibration").iterdir()}
    with pytest.raises(CliError) as caught:
        ready(["calibrate", str(cell), "tool", "--from", str(source)])
    assert words in str(caught.value)
    assert "bench.csv" in str(caught.value)
    assert {p.name: p.read_text() for p in (cell / "calibration").iterdir()} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["tool"], "--from"),
        (["tool", "--from", "x.csv", "y.csv"], "--from takes one"),
        (["tool", "tip", "--from", "x.csv"], "takes no 'tip'"),
        (["tool", "--from", "/nowhere/x.csv"], "cannot be read"),
        (["tool", "--from", "x.csv", "--arm", "PSM9"], "the cell has PSM1"),
        (["collect", "tip"], "--to FILE"),
        (["collect", "--to", "x.csv"], "MOTION (tip, roll, "),
        (["collect", "tip", "--to", "/nowhere/x.csv"], "no folder"),
    ],
)
def test_a_wrong_command_line_names_the_option(cell: Path, words: list[str], said: str) -> None:
    with pytest.raises(CliError) as caught:
        ready(["calibrate", str(cell), *words])
    assert said in str(caught.value)


def test_a_file_that_the_schema_refuses_is_not_written(cell: Path, tmp_path: Path) -> None:
    file = cell / "calibration" / "trocar_PSM1.yaml"
    before = file.read_text()
    point = surg_core.calibration.calibrate_trocar(
        [[0, 0, 3.0]] * 6,
        [[math.sin(a), math.cos(a), 0] for a in np.linspace(0, 2, 6)],
    )
    with pytest.raises(surg_core.ConfigError, match="point"):
        surg_core.calibration.write_trocar(
            file, surg_core.calibration.trocar_calibration(point, DATE), "too far away"
        )
    assert file.read_text() == before
    assert len(list(file.parent.iterdir())) == 2


def test_standstill_is_half_a_second_at_rest_and_each_place_counts_once() -> None:
    rng = np.random.default_rng(1)
    standstill = Standstill()
    found: list[tuple[float, np.ndarray]] = []
    q, places = np.zeros(6), [0.0, 0.3, 0.31, 0.6]
    for k in range(4000):  # 8 s at 500 Hz: two seconds at each place, half of it on the way there
        place, t = k // 1000, 0.002 * k
        before = places[max(place - 1, 0)]
        share = min(1.0, (k % 1000) / 500)
        q = np.full(6, before + share * (places[place] - before))
        rest = standstill.add(t, q + rng.normal(scale=2e-5, size=6))
        if rest is not None:
            found.append((t, rest))
    print([(round(t, 3), rest[0].round(5)) for t, rest in found])
    assert [round(float(rest[0]), 2) for _, rest in found] == [0.0, 0.3, 0.6], (
        "0.31 is no new place"
    )
    assert found[0][0] == pytest.approx(0.5, abs=0.003)
    for t, _ in found[1:]:
        assert 0.49 < (t % 2.0) - 1.0 < 0.52, "half a second after the motion has ended"
    assert np.abs(found[1][1] - 0.3).max() < 1e-5, "the mean is better than a sample"
    assert standstill.add(9.0, np.full(6, np.nan)) is None
