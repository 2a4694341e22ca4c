"""Show: both lenses and the baseline from rendered boards, by the very command."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.endoscope_files import copied_cell
from helpers.results.perception_results import PAGE, SIZES
from helpers.sim.board_bench import BenchView, BoardBench
from helpers.sim.board_views import BARREL, BOARD, PINHOLE, bench
from surg_core.lens_file import load_lens
from surg_core.pictures.lens_model import LensModel
from surg_core.stereo_file import load_stereo
from surg_perception.calibration import steps
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.result_files import Origin, read_stereo
from surg_perception.calibration.stereo import StereoFit, common
from surg_sim.appearance.lens import EndoscopeLens

ORIGIN = Origin("rendered", "2026-11-23", "simulated")


def errors_in_space(result: StereoFit, stand: BoardBench, views: list[BenchView]) -> np.ndarray:
    """Distance of triangulated corners from the true ones, in the true left eye (n,) [m]."""
    away = []
    for (left, right), view in zip(result.fit.solution.seen, views, strict=True):
        places, at_left, at_right = common(left, right)
        true = places @ view.X_VBoard[:3, :3].T + view.X_VBoard[:3, 3]
        away.append(np.linalg.norm(result.stereo.triangulate(at_left, at_right) - true, axis=1))
    return np.concatenate(away)


def check(result: StereoFit, stand: BoardBench, views: list[BenchView]) -> None:
    """The figures that are asked for."""
    off = 1e3 * (result.stereo.baseline - 0.004)
    true = errors_in_space(result, stand, views)
    held_out = float(np.median(result.errors))
    print(
        f"{stand.size}, k1 {stand.lenses[0].distortion[0]:g}: {len(views)} views, baseline off "
        f"{off:+.4f} mm, held out {result.held_out:.3f} px, in space {1e3 * held_out:.3f} mm, true "
        f"{1e3 * np.median(true):.3f} mm, rows {result.rows:.3f} px"
    )
    assert abs(off) <= 0.01
    assert held_out <= 3e-4
    assert np.median(true) <= 3e-4
    assert result.rows <= 0.2


def test_the_command_writes_what_the_loader_reads(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solve, results = steps.solve_stereo, []
    monkeypatch.setattr(
        steps, "solve_stereo", lambda *given: results.append(solve(*given)) or results[-1]
    )
    cell, folder = copied_cell(tmp_path), tmp_path / "views"
    stand = bench(1, BARREL)
    views = list(stand.held_board(13))
    stand.write(folder, views)
    write_board(folder / "board.yaml", BOARD)
    assert surg("calibrate", cell, "stereo", "--from", folder, "--lens-state", "ring at 2") == 0
    assert "held out" in capsys.readouterr().out
    page = (cell / "calibration" / "views" / "stereo.html").read_text("utf-8")
    drawings = [base64.b64decode(each) for each in re.findall(r'svg\+xml;base64,([^"]*)', page)]
    arrows = re.findall(rb'<g id="LineCollection_\d+">(.*?)</g>', b"".join(drawings), re.DOTALL)
    assert sum(each.count(b"<path d=") for each in arrows) > 13 * 2 * 40 and "held out" in page
    eyes, content = read_stereo(cell / "calibration")
    (result,) = results
    check(result, stand, views)
    np.testing.assert_allclose(eyes.X_LR, result.stereo.X_LR, atol=1e-12)
    assert (content.lens_state, content.evidence.n) == ("ring at 2", 13)
    # A pixel of the file's lens sees along the true ray.
    pixels = np.array([[20.0, 30.0], [320.0, 240.0], [600.0, 450.0]])
    lens = LensModel.of(load_lens(cell / "calibration" / "endoscope_left.yaml"))
    true = stand.lenses[0].rays(pixels, stand.eyes[0].f, *stand.size)
    assert np.abs(lens.rays(pixels)[:, :2] - true).max() * stand.eyes[0].f < 1.0
    assert load_stereo(cell / "calibration" / "endoscope_stereo.yaml").baseline > 0.0039


@pytest.mark.full
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("lens", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
def test_twenty_views_give_the_figures(
    lens: EndoscopeLens, size: tuple[int, int], tmp_path: Path
) -> None:
    stand = bench(1, lens, size)
    views = list(stand.held_board(20))
    stand.write(tmp_path / "views", views)
    write_board(tmp_path / "views" / "board.yaml", BOARD)
    result, _ = steps.stereo(tmp_path, tmp_path / "views", ORIGIN, write=False)
    check(result, stand, views)
    name = "barrel" if lens == BARREL else "pinhole"
    PAGE.note(
        f"stereo, 20 boards, {size[0]}x{size[1]}, {name}",
        1,
        f"baseline {1e3 * (result.stereo.baseline - 0.004):+.4f} mm, held-out "
        f"{result.held_out:.3f} px, {1e3 * np.median(result.errors):.3f} mm, rows "
        f"{result.rows:.3f} px",
    )
