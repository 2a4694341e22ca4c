"""A calibration corrected by what was seen, once a person has accepted it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from surg_core import ConfigError, make_pose
from surg_core.base_file import load_base, write_base
from surg_core.camera_file import camera_calibration, load_camera, write_camera
from surg_core.config import Cell
from surg_core.reading.pose_evidence import Evidence, file_sha256
from surg_core.transforms import FloatArray, rotation_of
from surg_perception.calibration.result_files import Origin
from surg_perception.calibration.small_motions import moved
from surg_perception.calibration.steps import scope_arm
from surg_perception.drift.drift_evidence import Verdict
from surg_perception.drift.drift_state import DriftState
from surg_perception.drift.moving_parts import BASE, CAMERA

CURES = {
    "lens": "./surg calibrate CELL stereo: measure the lenses again",
    "tool": "./surg calibrate CELL tool: measure the instrument again",
    "lag": "./surg calibrate CELL check, and the clocks of camera and robot",
}


def accept(cell: Cell, state: DriftState, verdict: Verdict | None, origin: Origin) -> list[Path]:
    """Write the part that moved as it stands now; what others stated before stays.

    Raises:
        ConfigError: Nothing moved, nobody can tell what, or it is no pose; nothing is written.
    """
    if verdict is None or not state.cause:
        raise ConfigError(f"{state.sentence()}. There is nothing to accept")
    part, folder = verdict.best, cell.folder / "calibration"
    step, covariance = verdict.x[part.at], verdict.covariance[part.at, part.at]
    if part.kind == CAMERA:
        return _camera(folder, scope_arm(cell).name, step, covariance, verdict.sightings, origin)
    if part.kind == BASE and part.of != next(iter(cell.arms)):
        file = folder / f"base_{part.of}.yaml"
        base = load_base(file)
        evidence = _evidence(base.evidence, covariance, verdict.sightings, origin)
        new = replace(base, X_WB=moved(base.X_WB, step), evidence=evidence)
        write_base(file, new, origin.note)
        return [file]
    cure = CURES.get(part.kind, "./surg calibrate CELL bases: measure the other bases against it")
    raise ConfigError(f"{part.name} moved, which no pose of the calibration corrects. Run {cure}")


def _camera(
    folder: Path, scope: str, step: FloatArray, covariance: FloatArray, n: int, origin: Origin
) -> list[Path]:
    """The camera's file; files that were measured through it keep belonging to it."""
    file = folder / f"camera_{scope}.yaml"
    camera, before = load_camera(file), file_sha256(file)
    assert camera.X_FV is not None and camera.evidence is not None
    X_VV = make_pose(step[3:], rotation_of(step[:3]))
    turned = np.kron(np.eye(2), camera.R_FV)
    evidence = _evidence(camera.evidence, turned @ covariance @ turned.T, n, origin)
    new = camera_calibration(camera.X_FV @ X_VV, evidence, camera.left_sha256, camera.right_sha256)
    write_camera(file, new, origin.note)
    written = [file]
    for path in sorted(folder.glob("base_*.yaml")):
        base = load_base(path)
        if base.camera_sha256 == before:
            write_base(path, replace(base, camera_sha256=file_sha256(file)), origin.note)
            written.append(path)
    return written


def _evidence(old: Evidence, covariance: FloatArray, n: int, origin: Origin) -> Evidence:
    return replace(old, covariance=covariance, n=n, date=origin.date, source=origin.source)
