"""The step ``bases`` of ``./surg calibrate``; see ``steps`` and ``chain_steps`` for the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import surg_core
from surg_core.base_calibration import in_axes
from surg_core.base_file import BaseCalibration, write_base
from surg_core.reading.pose_evidence import Evidence, file_sha256
from surg_core.transforms import FloatArray
from surg_perception.calibration import evidence
from surg_perception.calibration.bases import SeenBase, solve_base
from surg_perception.calibration.board import Board
from surg_perception.calibration.chain_steps import chain_error, measured_camera, tool_arm
from surg_perception.calibration.handeye import pair_pose
from surg_perception.calibration.result_files import (
    Origin,
    read_eyes,
    save_page,
)
from surg_perception.calibration.small_motions import covariance_of_inverse, transform
from surg_perception.calibration.steps import enough, find_board, scope_arm
from surg_perception.calibration.tip_views import (
    enough_tips,
    fitting,
    seen_tips,
    shaft_directions,
)
from surg_perception.calibration.triangulation import Stereo
from surg_perception.calibration.views import View, Views, read_views
from surg_perception.output.calibration_report import bases_page

STATED_PLACE = 0.005
"""[m] Standard deviation of each axis of a base's stated place; assumed. A turn by tip keeps it."""


def bases(
    cell: surg_core.Cell, source: Path, by: str, origin: Origin, write: bool = True
) -> tuple[FloatArray, SeenBase, list[str]]:
    """The base of the arm that is not the cell's first, through the endoscope.

    Args:
        cell: With a calibrated endoscope.
        source: Folder of views.
        by: ``touch`` or ``tip``.
        origin: Of the file.
        write: Whether the file is written.

    Returns:
        X_WB (4, 4) of that arm, the fit, and lines for people.

    Raises:
        ValueError: The folder, the cell or the evidence must not be used.
    """
    file = measured_camera(cell)[1]
    fit, left_out = _fit(cell, source, by)
    arm, base = base_in_world(cell, fit, by, origin, file)
    turn, shift = fit.error
    before = arm.X_WB_stated
    away = base.X_WB[:3, 3] - before[:3, 3]
    lines = [
        *left_out,
        f"{arm.name}: expected error {1e3 * shift:.2f} mm amid the points, "
        f"{np.degrees(turn):.3f} deg; n {fit.n}, rms {1e3 * fit.rms:.2f} mm",
        f"change {np.round(1e3 * away, 3).tolist()} mm from arms.{arm.name}.base",
    ]
    if write:
        path = cell.folder / "calibration" / f"base_{arm.name}.yaml"
        write_base(path, base, origin.note)
        try:
            chain = chain_error(surg_core.load_cell(cell.folder))
        except ValueError:  # such as no stereo file: `check` states what is missing
            chain = None
        page = save_page(path.parent, "bases", bases_page(fit, chain, origin.note))
        lines += [f"written: {each}" for each in (path, page)]
    return base.X_WB, fit, lines


def _fit(cell: surg_core.Cell, source: Path, by: str) -> tuple[SeenBase, list[str]]:
    """The tool arm's base in the scope arm's base, with its evidence checked; views left out."""
    camera, _ = measured_camera(cell)
    eyes, two = read_eyes(cell.folder / "calibration")
    count = 1 if two is None else 2
    covariance = camera.through_lenses
    assert camera.X_FV is not None and covariance is not None
    board = find_board(cell.folder / "calibration", source)
    views = read_views(source, board, look=by == "touch")
    X_FV = np.array(camera.X_FV)
    if by == "touch":
        p_S, p_T, X_SF = _by_touch(cell, views, eyes, X_FV, count)
        left_out = list(views.skipped)
    else:
        if two is None:
            raise evidence.Refused("bases", ["eyes: 1; by tip needs 2: use --by touch"])
        p_S, p_T, X_SF, left_out = _by_tip(cell, views, eyes, X_FV)
    fit = solve_base(p_S, p_T, X_SF, X_FV, covariance, smooth=by == "tip")
    if by == "touch":
        evidence.check_touch(fit)
    else:
        evidence.check_tip(fit, p_S)
    return fit, [f"left out {reason}" for reason in left_out]


def _by_touch(
    cell: surg_core.Cell, views: Views, eyes: Stereo, X_FV: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Touched corners as the scope sees them and by the joints; flanges of the scope."""
    enough(views, evidence.LEAST_TOUCHES, count)
    used = [view for view in views.with_board(count) if view.touch is not None]
    if len(used) < evidence.LEAST_TOUCHES:
        raise evidence.Refused(
            "bases", [f"touches: {len(used)}; at least {evidence.LEAST_TOUCHES}: touch more"]
        )
    X_SF = postures(scope_arm(cell), used)
    p_S = touched_corners(X_SF @ X_FV, eyes, used, views.board, count)
    return p_S, tips(tool_arm(cell), used), X_SF


def _by_tip(
    cell: surg_core.Cell, views: Views, eyes: Stereo, X_FV: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, list[str]]:
    """Tips as the scope sees them, as the joints state them, flanges of the scope, left out."""
    scope, tool = scope_arm(cell), tool_arm(cell)
    X_SF = postures(scope, views.views)
    s_V = shaft_directions(scope, tool, X_SF @ X_FV, postures(tool, views.views)[:, :3, :3])
    used, p_V, left_out = seen_tips(views, eyes, X_SF, s_V)
    enough_tips(used, left_out)
    X_SF, p_T = postures(scope, used), tips(tool, used)
    p_S = np.array([transform(X @ X_FV, p[None])[0] for X, p in zip(X_SF, p_V, strict=True)])
    keep = fitting(p_S, p_T)
    left_out += [
        f"{view.name}: what was found does not fit the other views; is the tip hidden?"
        for view, kept in zip(used, keep, strict=True)
        if not kept
    ]
    enough_tips([view for view, kept in zip(used, keep, strict=True) if kept], left_out)
    return p_S[keep], p_T[keep], X_SF[keep], left_out


def touched_corners(
    X_SV: FloatArray, eyes: Stereo, views: Sequence[View], board: Board, count: int
) -> FloatArray:
    """The touched corners as the scope sees them, in its arm's base (n, 3) [m]."""
    points = []
    for X, view in zip(X_SV, views, strict=True):
        pair = view.seen(board, count)
        assert pair is not None and view.touch is not None
        X_VBoard = pair_pose(eyes, pair)
        points.append(transform(X @ X_VBoard, board.corners[view.touch][None])[0])
    return np.array(points)


def postures(arm: surg_core.Arm, views: Sequence[View]) -> FloatArray:
    """Flange of an arm in its base (n, 4, 4)."""
    names = arm.robot.joint_names
    return np.array([arm.chain.forward(view.of_arm(arm.name, names)) for view in views])


def tips(tool: surg_core.Arm, views: Sequence[View]) -> FloatArray:
    """The tip by its joints, in the tool arm's base (n, 3) [m]."""
    names = tool.robot.joint_names
    poses = [tool.chain.forward(view.of_arm(tool.name, names)) for view in views]
    return np.array([X[:3, :3] @ tool.tool.p_FTip + X[:3, 3] for X in poses])


def base_in_world(
    cell: surg_core.Cell, fit: SeenBase, by: str, origin: Origin, camera_file: Path
) -> tuple[surg_core.Arm, BaseCalibration]:
    """The measured arm, which is not the cell's first, and its base in the world."""
    scope, tool = scope_arm(cell), tool_arm(cell)
    first = next(iter(cell.arms.values()))
    X, covariance, arm = fit.X_ST, fit.covariance, tool
    if first.name == tool.name:
        X = surg_core.inverse_pose(X)
        covariance, arm = covariance_of_inverse(fit.X_ST, covariance), scope
    known = tool if arm is scope else scope
    X_WB = known.X_WB @ X
    covariance = in_axes(covariance, known.X_WB[:3, :3])
    if by == "tip":
        X_WB[:3, 3] = arm.X_WB_stated[:3, 3]
        covariance[3:, :3] = covariance[:3, 3:] = 0.0
        covariance[3:, 3:] = STATED_PLACE**2 * np.eye(3)
    condition = float(fit.spread[0] / max(fit.spread[1], 1e-9))
    stated = cell.config.arms[0]
    return arm, BaseCalibration(
        X_WB=X_WB,
        method=by,
        evidence=Evidence(
            covariance, fit.rms, fit.n, max(1.0, condition), origin.date, origin.source
        ),
        reference=first.name,
        reference_xyz=np.array(stated.base_xyz),
        reference_rpy=np.array(stated.base_rpy),
        camera_sha256=file_sha256(camera_file),
    )
