"""Views that must not be used: the command names what, where and the cure, and writes nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.endoscope_files import copied_cell
from helpers.perception.made_up_views import folders, made_up
from helpers.sim.board_views import BOARD, scope_cell
from helpers.sim.calibrated_chain import ORIGIN, Chain
from surg_cli.host.terminal import CliError
from surg_perception.calibration.result_files import save_stereo
from surg_perception.calibration.stereo import StereoFit
from surg_perception.calibration.views import View

Change = Callable[[list[View]], list[View]]


@pytest.fixture(scope="module")
def measured() -> tuple[Chain, StereoFit, list[View]]:
    """An endoscope whose lenses are measured, and good views for its hand-eye pose."""
    chain = Chain(4, scope_cell())
    fit = chain.stereo()
    return chain, fit, made_up(chain.bench, chain.bench.moved_scope(14), chain.rng)


def turned(view: View, angle: float) -> View:
    """The first joint of the scope's arm moved after the picture."""
    first = next(name for name in view.joints if name.startswith("ECM/"))
    return replace(view, joints={**view.joints, first: view.joints[first] + angle})


def moved_during_the_fifth(views: list[View]) -> list[View]:
    return [*views[:4], turned(views[4], 0.05), *views[5:]]


def without_joints(views: list[View]) -> list[View]:
    return [replace(view, joints={}) for view in views]


def from_one_side(views: list[View]) -> list[View]:
    """The same posture again and again."""
    return [views[0]] * len(views)


def seen_by_one_eye(views: list[View]) -> list[View]:
    return [replace(view, corners=(view.corners[0], None)) for view in views]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda views: views, ""),
        (moved_during_the_fifth, r"rms: .*moved during a view.*number 5 of 14"),
        (without_joints, r"no column ECM/\w+: the joints of ECM are silent"),
        (from_one_side, r"turns: 0 and 0 deg about two axes; at least 20"),
        (seen_by_one_eye, "show the board to both eyes: 0; at least 10"),
        (lambda views: views[:9], "show the board to both eyes: 9; at least 10"),
    ],
)
def test_views_for_the_hand_eye_pose(
    change: Change,
    said: str,
    measured: tuple[Chain, StereoFit, list[View]],
    surg: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    chain, fit, views = measured
    cell = copied_cell(tmp_path)
    save_stereo(cell / "calibration", fit, BOARD, "", ORIGIN)
    of = folders(monkeypatch, tmp_path, {"scope": (chain.bench, change(views))})
    before = sorted(cell.rglob("*"))
    words = ["calibrate", cell, "handeye", "--from", of["scope"]]
    if not said:
        assert surg(*words) == 0
        return
    with pytest.raises(CliError, match=said):
        surg(*words)
    assert sorted(cell.rglob("*")) == before


def test_pictures_of_another_size_than_the_lens_files(
    measured: tuple[Chain, StereoFit, list[View]],
    surg: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    chain, fit, views = measured
    cell = copied_cell(tmp_path)
    save_stereo(cell / "calibration", fit, BOARD, "", ORIGIN)
    with monkeypatch.context() as patch:
        patch.setattr(chain.bench, "size", (960, 540))
        of = folders(monkeypatch, tmp_path, {"scope": (chain.bench, views)})
        with pytest.raises(CliError, match="960 x 540 px; the lens files are for 640 x 480"):
            surg("calibrate", cell, "handeye", "--from", of["scope"])


def test_a_right_eye_that_is_the_left_one_is_refused(
    measured: tuple[Chain, StereoFit, list[View]],
    surg: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Exchanged cables: the baseline points to the left."""
    chain = measured[0]
    shown = made_up(chain.bench, chain.bench.held_board(12), np.random.default_rng(1))
    swapped = [replace(view, corners=(view.corners[1], view.corners[0])) for view in shown]
    of = folders(monkeypatch, tmp_path, {"lenses": (chain.bench, swapped)})
    with pytest.raises(CliError, match=r"baseline: -[34]\.\d\d mm; .*the eyes are swapped"):
        surg("calibrate", copied_cell(tmp_path), "stereo", "--from", of["lenses"])
