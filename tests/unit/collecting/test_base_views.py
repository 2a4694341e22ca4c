"""Views for the base of the second arm: what is asked for, what is refused, what results."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.sim.board_bench import BenchView
from helpers.sim.board_views import BARREL, BOARD, Array, bench
from helpers.sim.calibrated_chain import ORIGIN, TOUCHED, Chain
from surg_cli.host.terminal import CliError
from surg_cli.robots import live_bases
from surg_core.base_file import load_base
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.result_files import save_handeye, save_stereo
from surg_perception.calibration.small_motions import difference
from surg_perception.calibration.views import read_views
from surg_perception.collecting import base_views
from surg_perception.collecting.base_views import WANTED, BaseViews, Moment


class Person:
    """Holds the board and the instrument before a calibrated endoscope."""

    def __init__(self, folder: Path) -> None:
        self.cell_folder = copied_cell(folder)
        calibration = self.cell_folder / "calibration"
        chain = Chain(2, surg_core.load_cell(self.cell_folder))
        stereo = chain.stereo()
        save_stereo(calibration, stereo, BOARD, "", ORIGIN)
        save_handeye(calibration, "ECM", chain.handeye(stereo), ORIGIN)
        write_board(calibration / "board.yaml", BOARD)
        self.X_W_ECM = chain.X_W_ECM
        self.cell = surg_core.load_cell(self.cell_folder)
        self.bench = bench(
            5,
            BARREL,
            cell=self.cell,
            pixels=30,
            X_FV=chain.bench.X_FV,
            X_WB={"ECM": self.X_W_ECM},
        )

    def touches(self, numbers: list[int]) -> Iterator[BenchView]:
        """Of corners, the board elsewhere after every fourth."""
        return self.bench.touches(BOARD.corners, numbers)

    def moment(self, view: BenchView, **changed: Array | None) -> Moment:
        """What eyes and arms show; ``changed`` joints of an arm, None: it moves."""
        return Moment(1.0, self.bench.pictures(view), {**view.joints, **changed})


@pytest.fixture(scope="module")
def person(tmp_path_factory: pytest.TempPathFactory) -> Person:
    return Person(tmp_path_factory.mktemp("cell"))


def test_each_touch_is_asked_for_and_what_is_none_is_not_taken(
    person: Person, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views = BaseViews(person.cell, "touch", tmp_path / "views")
    shown = [person.moment(view) for view in person.touches([0, 9, 60, 69, 0])]
    wrong = person.moment(next(person.touches([69])))
    blurred = Moment(
        1.0, tuple(cv2.GaussianBlur(p, (0, 0), 1.6) for p in shown[1].pair), shown[1].joints
    )
    empty = Moment(1.0, tuple(np.full_like(p, 90) for p in shown[1].pair), shown[1].joints)
    small = Moment(1.0, tuple(p[::2, ::2] for p in shown[1].pair), shown[1].joints)
    assert "upper left inner corner (number 0)" in views.request
    assert views.take(shown[0]) == ""
    assert "upper right inner corner (number 9)" in views.request
    for bad, why in (
        (shown[0], "the tip has not moved"),
        (Moment(1.0, shown[1].pair, {**shown[1].joints, "PSM1": None}), "PSM1 moves"),
        (Moment(1.0, shown[1].pair, {**shown[1].joints, "ECM": None}), "ECM moves"),
        (wrong, "mm from where the earlier touches put corner 9"),
        (blurred, "does not see the board"),
        (empty, "the left eye does not see the board"),
        (small, "the lens files are for 640 x 480"),
    ):
        assert why in views.take(bad)
    with monkeypatch.context() as patched:  # a detector that still finds the corners
        patched.setattr(base_views, "is_sharp", lambda look: False)
        assert "the picture is blurred" in views.take(shown[1])
    assert views.count == 1
    for moment in shown[1:4]:
        assert views.take(moment) == ""
    assert views.request.startswith("Move the board") and "(number 0)" in views.request
    assert views.take(shown[4]) == "" and views.undo() and views.count == 4
    found = read_views(views.path, BOARD)
    assert [view.touch for view in found.views] == [0, 9, 60, 69]
    for view, moment in zip(found.views, shown, strict=False):
        for arm in ("PSM1", "ECM"):
            q = view.of_arm(arm, person.cell.arms[arm].robot.joint_names)
            np.testing.assert_allclose(q, moment.joints[arm], atol=1e-8)
    done, reasons = views.solve(ORIGIN, True)
    assert not done and "4; at least 6" in reasons[0]
    assert views.wanted == WANTED["touch"] + 8
    assert not (person.cell_folder / "calibration" / "base_ECM.yaml").exists()


def test_by_tip_every_place_is_new(person: Person, tmp_path: Path) -> None:
    views = BaseViews(person.cell, "tip", tmp_path / "views")
    first, second = (person.moment(view) for view in person.touches([0, 69]))
    assert "new place" in views.request
    assert views.take(first) == "" and views.take(second) == ""
    assert "the tip has not moved" in views.take(first)
    assert [view.touch for view in read_views(views.path, BOARD, look=False).views] == [None] * 2


def test_what_the_cell_lacks_is_said_before_anything_is_asked(tmp_path: Path) -> None:
    cell = surg_core.load_cell(copied_cell(tmp_path))
    with pytest.raises(surg_core.ConfigError, match=r"camera_ECM.yaml: is missing; run"):
        BaseViews(cell, "touch", tmp_path / "views")
    assert not (tmp_path / "views").exists()


def at_terminal(
    person: Person, monkeypatch: pytest.MonkeyPatch, words: str, moments: Iterator[Moment | str],
    to: Path,
) -> Callable[[], int]:  # fmt: skip
    """`./surg calibrate CELL bases --by touch --live` with these words typed."""
    listening = SimpleNamespace(next=lambda: next(moments), close=lambda: None)
    monkeypatch.setattr(
        "surg_perception.collecting.base_moments_node.BaseMoments", lambda *_: listening
    )
    monkeypatch.setattr("sys.stdin", io.StringIO(words))
    options = SimpleNamespace(by="touch", to=to, port=11311, dry_run=False)
    return lambda: live_bases.calibrate(person.cell, options, "simulated", "2026-11-24")


def test_the_terminal_says_what_is_next_and_ends_where_nobody_types(
    person: Person, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    first = person.moment(next(person.touches([0])))
    moments: Iterator[Moment | str] = iter([first, "ECM states no joints (/ECM/...)"])
    run = at_terminal(person, monkeypatch, "\n\nu\nu\nx\ns\n", moments, tmp_path / "views")
    with pytest.raises(CliError, match="nobody is at the terminal; 0 views are in"):
        run()
    said = capsys.readouterr().out
    for words in (
        "1 of 32: Touch the upper right",
        "not taken: ECM states no joints",
        "the last view is deleted",
        "there is no view to delete",
        "'x': Enter takes a view",
        "not accepted yet",
    ):
        assert words in said, said


@pytest.mark.full
def test_touches_at_the_terminal_give_the_base(
    person: Person, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    moments = (person.moment(view) for view in person.touches(TOUCHED * 3))
    run = at_terminal(person, monkeypatch, "\n" * 96, moments, tmp_path / "views")
    assert run() == 0
    base = load_base(person.cell_folder / "calibration" / "base_ECM.yaml")
    off = difference(np.array(base.X_WB), person.X_W_ECM)
    turn = np.degrees(np.linalg.norm(off[:3]))
    print(f"base by touches at the terminal: n {base.evidence.n}, {turn:.3f} deg off")
    assert turn <= 0.2
