"""Marks of instruments in both pictures against the true eyes of the bench."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell, write_endoscope
from helpers.results.depth_results import PAGE
from helpers.sim.board_views import scope_cell
from helpers.sim.calibrated_chain import Chain
from surg_core import ConfigError
from surg_core.lens_file import Lens, load_lens
from surg_perception.calibration.small_motions import transform
from surg_perception.marks.mark_projection import MarkProjection, PictureMark
from surg_sim.physics.endoscope_rig import camera_poses

SIZE = (640, 480)
F = 451.4
HOME = np.array(scope_cell().arms["ECM"].robot.home)


def pinholes() -> tuple[Lens, Lens]:
    """What an instrument's file states: eyes without a lens, 4 mm apart."""
    K = np.array([[F, 0.0, 319.5], [0.0, F, 239.5], [0.0, 0.0, 1.0]])
    made = []
    for side, b in (("left", 0.0), ("right", 0.004)):
        P = np.hstack([K, np.array([[-F * b], [0.0], [0.0]])])
        made.append(Lens(*SIZE, f"endoscope_{side}", K, "plumb_bob", np.zeros(5), np.eye(3), P))
    return made[0], made[1]


def reached(chain: Chain, p_V: np.ndarray) -> np.ndarray:
    """Joints (n,) of PSM1 that bring its tip to a true place before the true left eye."""
    X_SV = chain.cell.arms["ECM"].chain.forward(HOME) @ chain.bench.X_FV
    X_TV = surg_core.inverse_pose(chain.bench.tool.arm.X_WB_stated) @ chain.X_W_ECM @ X_SV
    return chain.bench._touching(chain.bench.tool, transform(X_TV, p_V[None])[0])


def tips(
    projection: MarkProjection, q: np.ndarray, scope: np.ndarray = HOME
) -> tuple[PictureMark, PictureMark]:
    """The mark of the tip in the left and in the right eye."""
    left, right = projection.marks("PSM1", q, 0.3, scope)
    return next(m for m in left if m.name == "tip"), next(m for m in right if m.name == "tip")


def test_marks_without_any_error_lie_on_the_true_pixels(tmp_path: Path) -> None:
    cell = scope_cell()
    projection = MarkProjection(cell, pinholes())
    X_FV = camera_poses(cell.arms["ECM"])[0]
    tool, scope = cell.arms["PSM1"], cell.arms["ECM"]
    q = np.array(tool.robot.home) + 0.01
    X_WV = scope.X_WB @ scope.chain.forward(HOME) @ X_FV
    X_WF = tool.X_WB @ tool.chain.forward(q)
    p_V = (np.linalg.inv(X_WV) @ X_WF @ np.append(tool.tool.p_FTip, 1.0))[:3]
    for mark, shift in zip(tips(projection, q), (0.0, 0.004), strict=True):
        true = [319.5 + F * (p_V[0] - shift) / p_V[2], 239.5 + F * p_V[1] / p_V[2]]
        np.testing.assert_allclose(mark.pixels[0], true, atol=1e-6)
        assert mark.covariance is None  # nobody has measured this cell
    assert projection.arms == ("PSM1",)


def test_shaft_jaws_and_trocar_hang_together() -> None:
    cell = scope_cell()
    tool = cell.arms["PSM1"]
    projection = MarkProjection(cell, pinholes())
    q = np.array(tool.robot.home)
    by_angle = {}
    for jaw in (0.0, 0.5):
        marks = projection.marks("PSM1", q, jaw, HOME)[0]
        names = [mark.name for mark in marks]
        assert sorted(names) == ["jaw", "jaw", "shaft", "tip", "trocar"]
        by_angle[jaw] = [m.pixels for m in marks if m.name == "jaw"]
        tip = marks[names.index("tip")].pixels[0]
        np.testing.assert_allclose(marks[names.index("shaft")].pixels[0], tip)
        if jaw == 0.0:
            for each in by_angle[jaw]:
                np.testing.assert_allclose(each[-1], tip, atol=1e-6)
    ends = [each[-1] for each in by_angle[0.5]]
    # 18 mm long fingers, open by one radian, at the distance of the tip.
    apart = projection._instruments["PSM1"].at(q, 0.5)
    fingers = [m.p_W for m in apart if m.name == "jaw"]
    assert np.linalg.norm(fingers[0][-1] - fingers[1][-1]) == pytest.approx(
        2 * 0.018 * np.sin(0.5), rel=1e-3
    )
    np.testing.assert_allclose(fingers[0][0], fingers[1][0], atol=1e-12)
    assert np.linalg.norm(ends[0] - ends[1]) > 20.0
    assert not [m for m in projection.marks("PSM1", q, np.nan, HOME)[0] if m.name == "jaw"]


@pytest.fixture(scope="module")
def chains(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Chain, Path]]:
    """Cells whose errors nobody knows, after their calibration."""
    made = []
    for seed in range(20):
        folder = copied_cell(tmp_path_factory.mktemp(f"marks{seed}"))
        chain = Chain(seed, surg_core.load_cell(folder))
        chain.write(folder / "calibration")
        made.append((chain, folder))
    return made


@pytest.mark.full
def test_marks_before_and_after_the_chain(chains: list[tuple[Chain, Path]]) -> None:
    away: dict[str, list[float]] = {"before": [], "after": []}
    held = []
    for seed, (chain, folder) in enumerate(chains):
        rng = np.random.default_rng(500 + seed)
        eyes = [load_lens(folder / f"calibration/endoscope_{e}.yaml") for e in ("left", "right")]
        believed = {
            "before": MarkProjection(scope_cell(), pinholes()),
            "after": MarkProjection(surg_core.load_cell(folder), (eyes[0], eyes[1])),
        }
        for _ in range(5):
            p_V = np.append(rng.uniform(-0.02, 0.02, 2), 0.08)
            q = reached(chain, p_V)
            true = (
                chain.bench.eyes[0].project(p_V[None])[0],
                chain.bench.eyes[1].project(chain.bench._right(p_V[None]))[0],
            )
            for when, projection in believed.items():
                for mark, pixel in zip(tips(projection, q), true, strict=True):
                    off = mark.pixels[0] - pixel
                    away[when].append(float(np.linalg.norm(off)) * 0.08 / chain.bench.eyes[0].f)
                    if when == "after":
                        held.append(float(off @ np.linalg.solve(mark.covariance, off)) <= 4.0)
    before, after = (np.array(away[when]) for when in ("before", "after"))
    count = len(chains)
    PAGE.note(
        "marks: tip at 80 mm against its true place, after the calibration",
        count,
        f"median {1e3 * np.median(after):.2f} mm, largest {1e3 * after.max():.2f} mm",
    )
    PAGE.note(
        "marks: the same, before it",
        count,
        f"median {1e3 * np.median(before):.2f} mm, smallest {1e3 * before.min():.2f} mm; "
        f"{np.median(before) / np.median(after):.0f} times the median after it",
    )
    PAGE.note(
        "marks: two-sigma ellipse holds the true tip", len(held), f"{100 * np.mean(held):.0f} %"
    )
    assert after.max() <= 0.001
    assert np.median(before) >= 5.0 * np.median(after)
    # Two sigma in two dimensions hold 86 %.
    assert np.mean(held) >= 0.86


def test_the_ellipse_of_a_mark_is_two_sigma() -> None:
    tip = PictureMark("PSM1", "tip", np.array([[200.25, 100.5]]), np.diag([25.0, 4.0]))
    long, short, angle = tip.ellipse() or (0.0, 0.0, 0.0)
    assert (long, short) == pytest.approx((10.0, 4.0)) and np.sin(angle) == pytest.approx(0.0)
    nowhere = PictureMark("PSM1", "tip", np.full((1, 2), np.nan), np.full((2, 2), np.nan))
    assert nowhere.ellipse() is None


def test_a_cell_without_a_held_endoscope_is_refused() -> None:
    from surg_cli.host import paths

    with pytest.raises(ConfigError, match="no arm holds the endoscope"):
        MarkProjection(surg_core.load_cell(paths.CELLS / "sim_ur5e"), pinholes())


def test_a_stale_or_half_calibration_is_refused_or_gives_no_ellipse(tmp_path: Path) -> None:
    folder = copied_cell(tmp_path)
    calibration = folder / "calibration"
    X_FV = camera_poses(scope_cell().arms["ECM"])[0]
    write_endoscope(calibration, "ECM", X_FV)
    eyes = tuple(load_lens(calibration / f"endoscope_{e}.yaml") for e in ("left", "right"))
    projection = MarkProjection(surg_core.load_cell(folder), (eyes[0], eyes[1]))
    tip, _ = tips(projection, np.array(scope_cell().arms["PSM1"].robot.home))
    assert tip.ellipse() is None  # no base was measured
    file = calibration / "endoscope_left.yaml"
    file.write_text(file.read_text().replace("made up", "changed"))
    with pytest.raises(ConfigError, match=r"endoscope_stereo\.yaml"):
        MarkProjection(surg_core.load_cell(folder), (eyes[0], eyes[1]))
