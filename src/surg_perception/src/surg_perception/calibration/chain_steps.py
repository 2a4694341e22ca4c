"""The step ``check`` of ``./surg calibrate``: what is there, and what the chain is worth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import surg_core
from surg_core.base_file import check_base_camera, load_base
from surg_core.camera_file import CameraCalibration, check_camera_lenses, load_camera
from surg_core.stereo_file import StereoCalibration
from surg_core.transforms import FloatArray
from surg_perception.calibration.chain import DISTANCE, ChainError
from surg_perception.calibration.result_files import LEFT, RIGHT, STEREO, read_eyes, save_page
from surg_perception.calibration.small_motions import shift_at
from surg_perception.calibration.steps import scope_arm
from surg_perception.calibration.triangulation import Stereo
from surg_perception.output.calibration_report import chain_page


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
