"""The steps ``bases`` and ``check`` of ``./surg calibrate``; see ``steps`` for the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import surg_core
from surg_core.base_calibration import in_axes
from surg_core.base_file import BaseCalibration, check_base_camera, load_base, write_base
from surg_core.camera_file import CameraCalibration, check_camera_lenses, load_camera
from surg_core.checked_document import Evidence, file_sha256
from surg_core.stereo_file import StereoCalibration
from surg_core.transforms import FloatArray
from surg_perception.calibration import evidence
from surg_perception.calibration.bases import SeenBase, solve_base
from surg_perception.calibration.board import Board
from surg_perception.calibration.chain import DISTANCE, ChainError
from surg_perception.calibration.handeye import pair_pose
from surg_perception.calibration.result_files import (
    LEFT,
    RIGHT,
    STEREO,
    Origin,
    read_eyes,
    save_page,
)
from surg_perception.calibration.small_motions import covariance_of_inverse, shift_at, transform
from surg_perception.calibration.steps import enough, find_board, scope_arm
from surg_perception.calibration.tip_views import (
    enough_tips,
    fitting,
    seen_tips,
    shaft_directions,
)
from surg_perception.calibration.triangulation import Stereo
from surg_perception.calibration.views import View, Views, read_views
from surg_perception.output.calibration_report import bases_page, chain_page

STATED_PLACE = 0.005
"""[m] Standard deviation of each axis of a base's stated place; assumed. A turn by tip keeps it."""


def measured_camera(cell: surg_core.Cell) -> tuple[CameraCalibration, Path]:
    """The camera in the flange of the scope's arm, and its file.

    Raises:
        ConfigError: It is missing, states a rotation only, or is stale.
    """
    folder = cell.folder / "calibration"
    file = folder / f"camera_{scope_arm(cell).name}.yaml"
    if not file.is_file():
        raise surg_core.ConfigError(f"{file}: is missing; run ./surg calibrate CELL handeye first")
    camera = load_camera(file)
    if camera.X_FV is None or camera.evidence is None:
        raise surg_core.ConfigError(
            f"{file}: format: surg_camera/1 states a rotation only; allowed here: surg_camera/2, "
            "which ./surg calibrate CELL handeye writes"
        )
    check_camera_lenses(camera, file, folder / LEFT, folder / RIGHT)
    return camera, file


def tool_arm(cell: surg_core.Cell) -> surg_core.Arm:
    """The arm whose tip the scope sees: the first that does not hold the scope.

    Raises:
        ConfigError: There is none.
    """
    scope = scope_arm(cell).name
    for arm in cell.arms.values():
        if arm.name != scope:
            return arm
    raise surg_core.ConfigError(f"{cell.config.file}: one arm; bases need two")


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


def chain_error(cell: surg_core.Cell) -> ChainError:
    """What the chain of a cell is worth, 80 mm before the scope at its home posture.

    Raises:
        ConfigError: A file is missing, invalid or stale.
    """
    scope, tool = scope_arm(cell), tool_arm(cell)
    camera, file = measured_camera(cell)
    eyes, stereo = read_eyes(cell.folder / "calibration")
    of_camera = camera.through_lenses
    assert camera.X_FV is not None and of_camera is not None
    in_flange = camera.X_FV[:3, :3] @ [0.0, 0.0, DISTANCE]
    p_W = (_eye_at_home(cell, camera) @ [0.0, 0.0, DISTANCE, 1.0])[:3]
    first = next(iter(cell.arms.values()))
    arm = scope if first.name == tool.name else tool
    path = cell.folder / "calibration" / f"base_{arm.name}.yaml"
    if not path.is_file():
        raise surg_core.ConfigError(
            f"{path}: is missing; run ./surg calibrate CELL bases --by touch first"
        )
    base = load_base(path)
    check_base_camera(base, path, file)
    return ChainError(
        tool=tool.tool.residual,
        base=shift_at(base.evidence.covariance, p_W - base.X_WB[:3, 3]),
        handeye=shift_at(of_camera, in_flange),
        stereo=_of_pictures(eyes, stereo, camera),
    )


def _of_pictures(
    eyes: Stereo, stereo: StereoCalibration | None, camera: CameraCalibration
) -> float:
    """Expected error of what a picture states 80 mm away [m]: of one eye only across its ray."""
    if stereo is None:
        return DISTANCE * camera.residual / float(eyes.left.values[0])
    # The file states the median; an error along the ray is normal.
    return float(stereo.held_out[1]) / 0.6745


def _eye_at_home(cell: surg_core.Cell, camera: CameraCalibration) -> FloatArray:
    """The left eye in the world (4, 4) at the home posture of the scope's arm."""
    scope = scope_arm(cell)
    assert camera.X_FV is not None
    return np.asarray(scope.X_WB @ scope.chain.forward(scope.robot.home) @ camera.X_FV)


def check(cell: surg_core.Cell, title: str = "") -> list[str]:
    """What is there, how old it is, what the chain is worth, and what to do next.

    Args:
        cell: The cell.
        title: Of the page that is written when all files are there; empty: none is.
    """
    folder, scope = cell.folder / "calibration", scope_arm(cell)
    lines = []
    camera = scope.instrument.camera
    one_eye = camera is not None and len(camera.frames) == 1
    names = [LEFT, *(() if one_eye else (RIGHT, STEREO)), f"camera_{scope.name}.yaml"]
    names += [f"base_{arm.name}.yaml" for arm in list(cell.arms.values())[1:]]
    for name in names:
        if not (folder / name).is_file():
            lines.append(f"{name:24s} missing")
            continue
        date = surg_core.read_document(folder / name).values.get("date", "")
        lines.append(f"{name:24s} {date}")
    try:
        chain = chain_error(cell)
    except ValueError as error:
        return [*lines, f"next: {error}"]
    parts = {"tool": chain.tool, "bases": chain.base, "hand-eye": chain.handeye}
    parts["stereo"] = chain.stereo
    lines.append(", ".join(f"{name} {1e3 * sd:.2f} mm" for name, sd in parts.items()))
    lines.append(
        f"joints and picture agree within {1e3 * chain.two_sigma:.2f} mm (2 sigma) at "
        f"{1e3 * DISTANCE:g} mm"
    )
    if title:
        page = chain_page(cell, _eye_at_home(cell, measured_camera(cell)[0]), chain, title)
        lines.insert(0, f"written: {save_page(folder, 'check', page)}")
    return lines
