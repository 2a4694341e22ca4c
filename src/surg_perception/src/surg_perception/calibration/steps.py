"""The steps of ``./surg calibrate``: a folder of views in, files of the cell out.

Each step returns what a person wants to know, line by line, and writes nothing when it refuses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import surg_core
from surg_core.pictures.lens_model import LensModel
from surg_core.stereo_file import HELD_OUT_DISTANCES
from surg_perception.calibration import evidence
from surg_perception.calibration.board import Board, BoardError
from surg_perception.calibration.board_file import load_board
from surg_perception.calibration.handeye import HandEyeFit, solve_handeye
from surg_perception.calibration.intrinsics import LensFit, solve_lens
from surg_perception.calibration.result_files import (
    COVARIANCE,
    Origin,
    check_one_eye,
    read_eyes,
    read_lens_covariance,
    save_camera,
    save_handeye,
    save_page,
    save_stereo,
)
from surg_perception.calibration.small_motions import expected_error
from surg_perception.calibration.stereo import StereoFit, solve_stereo
from surg_perception.calibration.views import Views, read_views
from surg_perception.output.calibration_report import camera_page, handeye_page, stereo_page

BOARD = "board.yaml"


def find_board(calibration: Path, source: Path) -> Board:
    """The board of a folder of views, else the cell's.

    Raises:
        BoardError: Neither states one.
        ConfigError: Its file is invalid.
    """
    for file in (source / BOARD, calibration / BOARD):
        if file.is_file():
            return load_board(file)
    raise BoardError(
        f"no board: neither {source / BOARD} nor {calibration / BOARD}; state it by "
        "./surg calibrate CELL board --out board.pdf"
    )


def enough(views: Views, least: int, eyes: int = 2) -> None:
    """Refuse a folder with too few views of the board.

    Raises:
        Refused: It states the reasons of the views that were left out.
    """
    n = len(views.with_board(eyes))
    if n < least:
        why = f" ({views.skipped[0]})" if views.skipped else ""
        who = "both eyes" if eyes == 2 else "the left eye"
        reason = f"views that show the board to {who}: {n}; at least {least}{why}"
        raise evidence.Refused(str(views.folder), [reason])


def stereo(
    calibration: Path, source: Path, origin: Origin, lens_state: str = "", write: bool = True
) -> tuple[StereoFit, list[str]]:
    """Both lenses and the pose between them.

    Args:
        calibration: The cell's folder of calibrations.
        source: Folder of views.
        origin: Of the files.
        lens_state: Focus and zoom in words.
        write: Whether the files are written.

    Raises:
        ValueError: The folder, its board or its evidence must not be used.
    """
    views = read_views(source, find_board(calibration, source))
    enough(views, evidence.LEAST_VIEWS)
    pairs = [view.seen(views.board) for view in views.with_board()]
    result = solve_stereo([pair for pair in pairs if pair is not None], views.size)
    lines = [f"left out {reason}" for reason in views.skipped]
    lines += _stereo_lines(result)
    evidence.check_stereo(result, views.size)
    if write:
        paths = save_stereo(calibration, result, views.board, lens_state, origin)
        page = stereo_page(result, views.board, origin.note)
        paths.append(save_page(calibration, "stereo", page))
        lines += [f"written: {path}" for path in paths]
    return result, lines


def camera(
    calibration: Path, source: Path, origin: Origin, write: bool = True
) -> tuple[LensFit, list[str]]:
    """The lens of an endoscope with one eye; arguments as `stereo`."""
    check_one_eye(calibration)
    views = read_views(source, find_board(calibration, source))
    enough(views, evidence.LEAST_VIEWS, 1)
    pairs = [view.seen(views.board, 1) for view in views.with_board(1)]
    result = solve_lens([pair[0] for pair in pairs if pair is not None], views.size)
    lens = result.lens
    errors = ", ".join(f"{model} {px:.3f}" for model, px in result.errors_of_models.items())
    lines = [
        *(f"left out {reason}" for reason in views.skipped),
        f"lens     {lens.model} (held out [px]: {errors})",
        _eye_line("left", lens),
        f"evidence n {len(result.fit.residuals)}, rms {result.fit.rms:.3f} px, held out "
        f"{result.held_out:.3f} px",
    ]
    evidence.check_lens(result, views.size)
    if write:
        page = camera_page(result, views.board, origin.note)
        paths = [*save_camera(calibration, result, origin), save_page(calibration, "camera", page)]
        lines += [f"written: {path}" for path in paths]
    return result, lines


def _eye_line(name: str, eye: LensModel) -> str:
    return (
        f"{name:8s} fx {eye.values[0]:.2f}, fy {eye.values[1]:.2f}, cx {eye.values[2]:.2f}, "
        f"cy {eye.values[3]:.2f} px; D {np.round(eye.D, 4).tolist()}"
    )


def _stereo_lines(result: StereoFit) -> list[str]:
    fit, lens = result.fit, result.stereo.left
    turn, shift = np.degrees(result.pose_error[0]), 1e3 * result.pose_error[1]
    errors = ", ".join(f"{model} {px:.3f}" for model, px in result.errors_of_models.items())
    at = ", ".join(
        f"{1e3 * result.error_at(z):.2f} mm at {1e3 * z:g} mm" for z in HELD_OUT_DISTANCES
    )
    return [
        f"lens     {lens.model} (held out [px]: {errors})",
        _eye_line("left", result.stereo.left),
        _eye_line("right", result.stereo.right),
        f"stereo   baseline {1e3 * result.stereo.baseline:.3f} mm; expected error "
        f"{shift:.3f} mm, {turn:.3f} deg",
        f"evidence n {len(fit.residuals)}, rms {fit.rms:.3f} px, held out "
        f"{result.held_out:.3f} px, rows {result.rows:.3f} px, {result.left_out} corners left out",
        f"in space {at} (median of held-out corners)",
    ]


def scope_arm(cell: surg_core.Cell) -> surg_core.Arm:
    """The arm that holds the endoscope.

    Raises:
        ConfigError: None does.
    """
    for arm in cell.arms.values():
        if arm.instrument.camera is not None:
            return arm
    raise surg_core.ConfigError(
        f"{cell.config.file}: no arm holds an endoscope (an instrument with a camera)"
    )


def handeye(
    cell: surg_core.Cell, source: Path, origin: Origin, write: bool = True
) -> tuple[HandEyeFit, list[str]]:
    """The left eye in the flange of the arm that holds the endoscope; arguments as `stereo`."""
    calibration = cell.folder / "calibration"
    arm = scope_arm(cell)
    eyes, two = read_eyes(calibration)
    count = 1 if two is None else 2
    views = read_views(source, find_board(calibration, source))
    if views.size != eyes.left.size:
        raise evidence.Refused(
            str(source),
            [f"size: {views.size[0]} x {views.size[1]} px; the lens files are for "
             f"{eyes.left.size[0]} x {eyes.left.size[1]}: take views of that size"],
        )  # fmt: skip
    enough(views, evidence.LEAST_POSTURES, count)
    seen, poses = [], []
    for view in views.with_board(count):
        pair = view.seen(views.board, count)
        if pair is not None:
            seen.append(pair)
            poses.append(arm.chain.forward(view.of_arm(arm.name, arm.robot.joint_names)))
    lenses = read_lens_covariance(calibration)
    result = solve_handeye(eyes, np.array(poses), seen, lenses)
    turn, shift = np.degrees(result.pose_error[0]), 1e3 * result.pose_error[1]
    p = ", ".join(f"{1e3 * value:.3f}" for value in result.X_FV[:3, 3])
    lines = [
        *(f"left out {reason}" for reason in views.skipped),
        f"camera   [{p}] mm in the flange of {arm.name}; expected error {shift:.3f} mm, "
        f"{turn:.3f} deg",
        f"evidence n {len(seen)}, rms {result.fit.rms:.3f} px, turns "
        f"{np.degrees(result.turns[0]):.0f} and {np.degrees(result.turns[1]):.0f} deg, condition "
        f"{result.fit.condition:.0f}",
        *_lens_line(result, calibration),
    ]
    evidence.check_handeye(result)
    if write:
        page = handeye_page(result, views.board, origin.note)
        paths = [save_handeye(calibration, arm.name, result, origin)]
        paths.append(save_page(calibration, "handeye", page))
        lines += [f"written: {path}" for path in paths]
    return result, lines


def _lens_line(result: HandEyeFit, calibration: Path) -> list[str]:
    """What part of the expected error the lenses have."""
    if result.lens_share is None:
        return [
            f"lens     its error is not in the expected error: no {calibration / COVARIANCE}; "
            "./surg calibrate CELL stereo (one eye: camera) writes it"
        ]
    turn, shift = expected_error(result.lens_share)
    return [f"lens     its part of that error: {1e3 * shift:.3f} mm, {np.degrees(turn):.3f} deg"]
