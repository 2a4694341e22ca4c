"""Collecting views: which looks become views, what is still missing, and a whole step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.sim.board_bench import BenchView, BoardBench
from helpers.sim.board_views import BARREL, BOARD, Array, bench, moved_camera
from surg_core import standstill
from surg_core.transforms import rotation_of
from surg_perception.calibration import evidence
from surg_perception.calibration.board import Corners
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.intrinsics import SeenCorners
from surg_perception.calibration.result_files import Origin
from surg_perception.calibration.small_motions import difference
from surg_perception.calibration.views import read_views
from surg_perception.collecting import board_detection, collector
from surg_perception.collecting.board_detection import (
    BoardDetection,
    edge_blur,
    is_new,
    is_sharp,
    is_still,
)
from surg_perception.collecting.collector import CalibrationStep, Collector
from surg_perception.collecting.live_calibration import CalibrationState, LiveCalibration

SIZE = (640, 480)
PERIOD = 0.05


def look(
    of: BoardBench, view: BenchView, stamp: float = 0.0, blur: float = 0.03, shift: float = 0.0
) -> BoardDetection:
    """What a perfect detector says of a view; ``shift`` [px] of all corners to the right."""
    seen = []
    for pixels in of.pixels(view, BOARD.corners):
        inside = ((pixels > 3) & (pixels < np.array(SIZE) - 4)).all(axis=1)
        seen.append(Corners(np.flatnonzero(inside), pixels[inside] + [shift, 0.0]))
    X = board_detection.centred(view.X_VBoard, BOARD)
    found = BoardDetection(stamp, (seen[0], seen[1]), blur, BOARD.side_in(seen[0]), X)
    q = view.joints["ECM"]
    return replace(found, q=q, X_BF=np.array(of.cell.arms["ECM"].chain.forward(q)))


def rest(of: BoardBench, view: BenchView, start: float, count: int = 8) -> list[BoardDetection]:
    """A view that is held."""
    return [look(of, view, start + PERIOD * k) for k in range(count)]


def test_a_held_board_is_still_and_a_moving_one_is_not() -> None:
    of = bench(0, BARREL, pixels=8)
    view = next(of.held_board(1))
    held = rest(of, view, 0.0)
    assert is_still(held) and not is_still(held[:5]) and not is_still([])
    side = held[0].side
    for speed, still in ((0.5, True), (2.0, False)):  # of the largest motion in the time
        step = speed * board_detection.MOST_MOTION * side * PERIOD / board_detection.STILL_S
        looks = [look(of, view, PERIOD * k, shift=step * k) for k in range(8)]
        assert is_still(looks) is still, speed
    jolted = [*held[:-1], look(of, view, held[-1].stamp, shift=0.1 * side)]
    assert not is_still(jolted)
    shaken = [replace(each, stamp=each.stamp) for each in held]
    shaken[4] = look(of, view, held[4].stamp, shift=0.1 * side)
    assert not is_still(shaken), "it was elsewhere in between"


def test_the_blur_of_an_edge_is_measured_and_limits_a_view() -> None:
    rng = np.random.default_rng(0)
    pattern = cv2.copyMakeBorder(BOARD.picture(24), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    row, column = np.divmod(np.arange(70), 10)
    pixels = np.column_stack([40 + 24 * (column + 1), 40 + 24 * (row + 1)]) - 0.5
    found = []
    for sigma in (1.0, 1.5, 2.0, 3.0):
        soft = cv2.GaussianBlur(pattern.astype(np.float32), (0, 0), sigma)
        noisy = np.clip(soft + rng.normal(scale=2.0, size=soft.shape), 0, 255).astype(np.uint8)
        found.append(edge_blur(noisy, pixels, 24.0))
    print("blur 1.0, 1.5, 2.0, 3.0 px read as", np.round(found, 2))
    assert found == pytest.approx([1.0, 1.5, 2.0, 3.0], abs=0.3)
    view = next(bench(0, pixels=8).held_board(1))
    of = bench(0, pixels=8)
    limit = board_detection.MOST_BLUR
    assert is_sharp(look(of, view, blur=0.99 * limit))
    assert not is_sharp(look(of, view, blur=1.01 * limit))


def test_new_is_another_place_of_the_board_or_another_posture() -> None:
    of = bench(0, pixels=8)
    view = next(of.held_board(1))
    first = look(of, view)
    assert is_new(first, []) and not is_new(first, [first])
    for share, new in ((0.9, False), (1.1, True)):
        aside, away, leaned = (view.X_VBoard.copy() for _ in range(3))
        aside[0, 3] += share * board_detection.NEW_SHIFT * first.distance
        away[:3, 3] += (np.exp(share * board_detection.NEW_DISTANCE) - 1) * first.X_VBoard[:3, 3]
        middle = BOARD.corners.mean(axis=0)
        p = leaned[:3, :3] @ middle + leaned[:3, 3]
        leaned[:3, :3] = (
            rotation_of(np.array([share * board_detection.NEW_TURN, 0, 0])) @ leaned[:3, :3]
        )
        leaned[:3, 3] = p - leaned[:3, :3] @ middle
        for X in (aside, away, leaned):
            assert is_new(look(of, replace(view, X_VBoard=X)), [first]) is new
        assert first.X_BF is not None
        X_BF = first.X_BF.copy()
        X_BF[:3, :3] = (
            rotation_of(np.array([0, share * board_detection.NEW_POSTURE, 0])) @ X_BF[:3, :3]
        )
        assert is_new(replace(first, X_BF=X_BF), [first], by_posture=True) is new


def collect(step: CalibrationStep, of: BoardBench, views: list[BenchView]) -> Collector:
    """Hold every view for a moment; stops when nothing is missing."""
    made = Collector(step, BOARD, SIZE)
    for number, view in enumerate(views):
        for each in rest(of, view, float(number)):
            made.offer(each)
        if made.complete:
            break
    return made


def test_a_person_who_follows_the_hints_gets_an_accepted_stereo_set() -> None:
    of = bench(3, BARREL, pixels=8)
    made = collect(CalibrationStep.STEREO, of, list(of.held_board(60)))
    print(f"{len(made.taken)} views, progress {made.progress:.2f}, missing {made.missing}")
    assert made.complete and made.progress == pytest.approx(1.0)
    assert collector.WANTED_STEREO <= len(made.taken) <= 30
    assert (made.fields[collector.needed_fields(SIZE)] > 0).all()
    for band in (collector.distance_band, collector.tilt_band):
        assert np.bincount([band(each) for each in made.taken], minlength=3).min() >= 3
    corners = [[each.corners[eye] for each in made.taken] for eye in (0, 1)]
    for eye in (0, 1):
        assert (
            evidence.coverage(
                [SeenCorners(BOARD.corners[c.ids], c.pixels) for c in corners[eye]], SIZE
            ).min()
            >= evidence.LEAST_COVERAGE
        )


def test_a_set_from_one_side_is_never_complete_and_says_where() -> None:
    of = bench(3, BARREL, pixels=8)
    left = [view for view in of.held_board(80) if view.X_VBoard[0, 3] < -0.05]
    made = collect(CalibrationStep.STEREO, of, left)
    assert not made.complete and made.progress < 1.0
    assert "right" in made.missing[0]


def test_a_view_is_taken_once_and_can_be_undone() -> None:
    of = bench(0, pixels=8)
    made = Collector(CalibrationStep.STEREO, BOARD, SIZE)
    views = list(of.held_board(2))
    answers = [made.offer(each) for each in rest(of, views[0], 0.0, 12)]
    assert answers.count("") == 1 and len(made.taken) == 1
    assert not answers[6], "after 0.3 s"
    assert made.undo() and not made.undo()
    blurred = [replace(each, blur=0.2) for each in rest(of, views[1], 2.0)]
    assert all(made.offer(each) for each in blurred)
    made.lose()
    assert not made.taken


def test_a_hand_eye_set_needs_turns_about_two_axes() -> None:
    of = bench(1, BARREL, pixels=8, X_FV=moved_camera(np.random.default_rng(1)))
    made = collect(CalibrationStep.HANDEYE, of, list(of.moved_scope(40)))
    assert made.complete and len(made.taken) >= collector.WANTED_HANDEYE
    one = Collector(CalibrationStep.HANDEYE, BOARD, SIZE)
    first = rest(of, next(of.moved_scope(1)), 0.0)
    X = first[0].X_BF
    assert X is not None
    for number in range(30):
        turned = X.copy()
        turned[:3, :3] = X[:3, :3] @ rotation_of(np.array([0, 0, np.radians(5.5) * number]))
        for each in first:
            one.offer(replace(each, stamp=each.stamp + number, X_BF=turned))
    assert len(one.taken) >= collector.WANTED_HANDEYE and not one.complete
    assert any("another axis" in text for text in one.missing)
    assert one.offer(replace(first[0], stamp=99.0, X_BF=None)) == "Hold the endoscope still."


def test_an_arm_is_at_rest_only_if_its_states_span_the_time() -> None:
    q = np.zeros(6)
    states = [(0.002 * k, q) for k in range(400)]
    assert standstill.resting(states, 0.79) is not None
    assert standstill.resting(states, 0.4) is None, "they begin too late"
    assert standstill.resting(states, 1.0) is None, "they are too old"
    assert standstill.resting([], 1.0) is None
    moving = [(t, q + (0.002 * t if t > 0.5 else 0.0)) for t, q in states]
    assert standstill.resting(moving, 0.79) is None


# --- a whole step, with pictures -------------------------------------------------------------


def session(folder: Path, tmp_path: Path) -> LiveCalibration:
    made = iter(tmp_path / f"views_{k}" for k in range(9))
    write_board(folder / "calibration" / "board.yaml", BOARD)
    cell = surg_core.load_cell(folder)
    return LiveCalibration(
        cell, lambda step: next(made), lambda step, path: Origin("live", "2026-11-23", "simulated")
    )


def watch(live: LiveCalibration, of: BoardBench, view: BenchView, start: float, count: int) -> None:
    """Pictures of a view that is held."""
    pair = of.pictures(view)
    for k in range(count):
        live.see(start + 0.1 * k, pair, view.joints["ECM"])


def test_views_are_stored_undone_and_read_by_the_solver(tmp_path: Path) -> None:
    live = session(copied_cell(tmp_path), tmp_path)
    of = bench(0, cell=live.cell, pixels=30)
    first, second = of.held_board(2)
    live.undo()
    assert live.status.state is CalibrationState.IDLE
    live.start(CalibrationStep.STEREO)
    watch(live, of, first, 0.0, 4)
    watch(live, of, second, 1.0, 4)
    assert live.status.views == 2 and len(live.status.corners) > 40
    views = read_views(tmp_path / "views_0", BOARD)
    assert [view.name for view in views.with_board()] == ["000", "001"]
    live.undo()
    assert live.status.views == 1
    assert len(read_views(tmp_path / "views_0", BOARD).views) == 1
    assert not (tmp_path / "views_0" / "001_left.png").exists()
    live.see(2.0, (np.full((480, 640), 90, np.uint8),) * 2)
    assert live.status.corners == () and "does not see the board" in live.status.hint
    live.ask_to_solve()
    assert not live.step_on() and live.status.state is CalibrationState.COLLECTING
    assert any(reason.startswith("views") for reason in live.status.result)
    with pytest.raises(ValueError, match="endoscope_stereo"):
        live.start(CalibrationStep.HANDEYE)


@pytest.mark.full
def test_one_eye_alone_is_calibrated_from_its_own_pictures(tmp_path: Path) -> None:
    live = session(copied_cell(tmp_path), tmp_path)
    live.left_only = True
    X_FV = moved_camera(np.random.default_rng(5))
    of = bench(5, BARREL, cell=live.cell, pixels=30, X_FV=X_FV)
    for step, views in (
        (CalibrationStep.STEREO, of.held_board(150)),
        (CalibrationStep.HANDEYE, of.moved_scope(40)),
    ):
        live.start(step)
        assert live.eyes == 1
        for number, view in enumerate(views):
            left = of.pictures(view)[:1]
            for k in range(4):
                live.see(number + 0.1 * k, left, view.joints["ECM"])
            if live.step_on():
                break
        assert live.status.state is CalibrationState.DONE, live.status.result
    calibration = live.cell.folder / "calibration"
    assert not (calibration / "endoscope_right.yaml").exists()
    assert not list((tmp_path / "views_0").glob("*_right.png"))
    camera, _ = surg_core_camera(live.cell)
    step_ = difference(camera, X_FV)
    shift, angle = 1e3 * np.linalg.norm(step_[3:]), np.degrees(np.linalg.norm(step_[:3]))
    print(f"hand-eye of one eye from a running system: {shift:.3f} mm, {angle:.3f} deg off")
    assert shift <= 0.6 and angle <= 0.2


def test_one_eye_of_a_cell_that_has_measured_two_is_refused_at_once(tmp_path: Path) -> None:
    live = session(copied_cell(tmp_path), tmp_path)
    live.left_only = True
    (live.cell.folder / "calibration" / "endoscope_right.yaml").touch()
    with pytest.raises(ValueError, match="this cell has two eyes"):
        live.start(CalibrationStep.STEREO)
    assert not (tmp_path / "views_0").exists()


def surg_core_camera(cell: surg_core.Cell) -> tuple[Array, Path]:
    from surg_perception.calibration.chain_steps import measured_camera

    camera, file = measured_camera(cell)
    assert camera.X_FV is not None
    return np.array(camera.X_FV), file
