"""An endoscope with one eye, and what the hand-eye step writes for others, by the very commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell, write_endoscope
from helpers.perception.made_up_views import folders, made_up
from helpers.sim.board_views import BOARD, scope_cell
from helpers.sim.calibrated_chain import TOUCHED, Chain
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core.camera_file import load_camera
from surg_core.lens_file import load_lens
from surg_core.pictures.lens_model import LensModel
from surg_perception.calibration.chain_steps import chain_error
from surg_perception.calibration.small_motions import difference


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(3, scope_cell())


def one_eyed(chain: Chain, monkeypatch: pytest.MonkeyPatch, root: Path) -> dict[str, Path]:
    bench = chain.bench
    shown = {
        "lenses": list(bench.held_board(20)),
        "scope": list(bench.moved_scope(15)),
        "tip": list(bench.touches(BOARD.corners, TOUCHED * 2)),
    }
    views = {name: (bench, made_up(bench, each, chain.rng)) for name, each in shown.items()}
    for _, each in views.values():
        for number, view in enumerate(each):
            each[number] = type(view)(**{**vars(view), "corners": (view.corners[0], None)})
    return folders(monkeypatch, root, views)


def test_the_chain_of_one_eye(
    chain: Chain, surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    cell, of = copied_cell(tmp_path), one_eyed(chain, monkeypatch, tmp_path)
    calibration = cell / "calibration"
    with pytest.raises(CliError, match="both eyes: 0"):
        surg("calibrate", cell, "stereo", "--from", of["lenses"])
    assert surg("calibrate", cell, "camera", "--from", of["lenses"]) == 0
    lens = LensModel.of(load_lens(calibration / "endoscope_left.yaml"))
    pixels = np.array([[40.0, 40.0], [320.0, 240.0], [600.0, 440.0]])
    eye = chain.bench.eyes[0]
    true = chain.bench.lenses[0].rays(pixels, eye.f, *chain.bench.size)
    off = np.abs(lens.rays(pixels)[:, :2] - true).max() * eye.f
    words = ["calibrate", cell, "handeye", "--from", of["scope"]]
    assert surg(*words) == 0
    assert "lens     its part of that error: " in capsys.readouterr().out
    camera = load_camera(calibration / "camera_ECM.yaml")
    assert camera.right_sha256 == "none"
    step = difference(np.array(camera.X_FV), chain.bench.X_FV)
    assert surg("calibrate", cell, "bases", "--by", "touch", "--from", of["tip"]) == 0
    assert surg("calibrate", cell, "check") == 0
    assert "joints and picture agree within" in capsys.readouterr().out
    turn, shift = np.degrees(np.linalg.norm(step[:3])), 1e3 * np.linalg.norm(step[3:])
    stated = 1e3 * chain_error(surg_core.load_cell(cell)).two_sigma
    print(
        f"one eye: ray {off:.2f} px, camera {shift:.3f} mm, {turn:.3f} deg; chain {stated:.2f} mm"
    )
    assert off < 1.0 and shift <= 0.6 and turn <= 0.2 and stated <= 2.0


def test_one_eye_does_not_replace_two(surg: Callable[..., int], tmp_path: Path) -> None:
    cell = copied_cell(tmp_path)
    write_endoscope(cell / "calibration", "ECM")
    before = (cell / "calibration" / "endoscope_left.yaml").read_text()
    with pytest.raises(CliError, match=r"endoscope_right.yaml: this cell has two eyes"):
        surg("calibrate", cell, "camera", "--from", tmp_path)
    assert (cell / "calibration" / "endoscope_left.yaml").read_text() == before


def test_views_are_needed(surg: Callable[..., int], tmp_path: Path) -> None:
    with pytest.raises(CliError, match="--from FOLDER"):
        surg("calibrate", copied_cell(tmp_path), "camera")


def test_a_pair_is_refused_live_where_the_endoscope_has_one_eye(
    surg: Callable[..., int], tmp_path: Path
) -> None:
    cell = copied_cell(tmp_path)
    drawn = paths.ROOT / "src" / "surg_description" / "instruments" / "endoscope.yaml"
    text = drawn.read_text().replace("[camera_left, camera_right]", "[camera_left]")
    text = "".join(li for li in text.splitlines(True) if not li.startswith("  baseline:"))
    one = cell / "one_eye.yaml"
    one.write_text(text.replace("../urdf", str(drawn.parent.parent / "urdf")))
    stated = (cell / "cell.yaml").read_text().replace(str(drawn), str(one))
    (cell / "cell.yaml").write_text(stated)
    camera = surg_core.load_cell(cell).arms["ECM"].instrument.camera
    assert camera is not None and len(camera.frames) == 1
    before = sorted(cell.rglob("*"))
    with pytest.raises(CliError, match="the endoscope has one eye; use camera --live"):
        surg("calibrate", cell, "stereo", "--live")
    with pytest.raises(CliError, match="--live goes with stereo, camera, handeye, bases --by"):
        surg("calibrate", cell, "check", "--live")
    assert sorted(cell.rglob("*")) == before
