"""A calibration corrected by what was seen, once a person has accepted it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from surg_core import ConfigError
from surg_core.base_file import load_base, write_base
from surg_core.camera_file import camera_calibration, load_camera, write_camera
from surg_core.config import Cell
from surg_core.lens_file import Lens
from surg_core.reading.pose_evidence import Evidence, file_sha256
from surg_core.transforms import FloatArray
from surg_perception.calibration.result_files import Origin
from surg_perception.calibration.steps import scope_arm
from surg_perception.drift.drift_state import DriftState
from surg_perception.drift.moving_parts import BASE, CAMERA, Part
from surg_perception.drift.stated_parts import stated_parts
from surg_perception.drift.whole_recording import Found, Look, find

CURES = {
    "lens": "./surg calibrate CELL stereo: measure the lenses again",
    "tool": "./surg calibrate CELL tool: measure the instrument again",
    "lag": "./surg calibrate CELL check, and the clocks of camera and robot",
}


def accept(
    cell: Cell, state: DriftState, lenses: Sequence[Lens], look: Look, origin: Origin
) -> list[Path]:
    """Write the part that moved as it stands now; what others stated before stays.

    Args:
        cell: As it is calibrated.
        state: At the recording's end; names the part.
        lenses: Of the recorded eyes.
        look: Shows a watch what was recorded since the motion.
        origin: Of what is written.

    Raises:
        ConfigError: Nothing moved, nobody can tell what, it is no pose, or too little was
            recorded; nothing is written.
    """
    parts = stated_parts(cell)
    part = _named(cell, parts, state.cause)
    if part is None:
        raise ConfigError(f"{state.sentence()}. There is nothing to accept")
    if part.kind not in (CAMERA, BASE) or part.of == next(iter(cell.arms)):
        other = "./surg calibrate CELL bases: measure the other bases against it"
        cure = CURES.get(part.kind, other)
        raise ConfigError(
            f"{part.name} moved, which no pose of the calibration corrects. Run {cure}"
        )
    folder, found = cell.folder / "calibration", find(cell, part, lenses, parts, look)
    if part.kind == CAMERA:
        return _camera(folder, scope_arm(cell).name, found, origin)
    file = folder / f"base_{part.of}.yaml"
    base = load_base(file)
    new = _evidence(base.evidence, found.covariance, found, origin)
    write_base(file, replace(base, X_WB=found.pose, evidence=new), origin.note)
    return [file]


def _named(cell: Cell, parts: Sequence[Part], cause: str) -> Part | None:
    """The part that a cause names; None: none, or one of several.

    Of two arms nobody knows more than how one base stands to the other: the second's file says it.
    """
    names = cause.split(" or ")
    named = [part for part in parts if part.name in names]
    if len(cell.arms) == 2 and {part.kind for part in named} == {BASE}:
        return next(part for part in parts if part.name == f"{BASE} of {list(cell.arms)[1]}")
    return named[0] if len(named) == len(names) == 1 else None


def _camera(folder: Path, scope: str, found: Found, origin: Origin) -> list[Path]:
    """The camera's file; files that were measured through it keep belonging to it."""
    file = folder / f"camera_{scope}.yaml"
    camera, before = load_camera(file), file_sha256(file)
    assert camera.evidence is not None
    turned = np.kron(np.eye(2), found.pose[:3, :3])
    evidence = _evidence(camera.evidence, turned @ found.covariance @ turned.T, found, origin)
    new = camera_calibration(found.pose, evidence, camera.left_sha256, camera.right_sha256)
    write_camera(file, new, origin.note)
    written = [file]
    for path in sorted(folder.glob("base_*.yaml")):
        base = load_base(path)
        if base.camera_sha256 == before:
            write_base(path, replace(base, camera_sha256=file_sha256(file)), origin.note)
            written.append(path)
    return written


def _evidence(old: Evidence, covariance: FloatArray, found: Found, origin: Origin) -> Evidence:
    n = found.sightings
    return replace(old, covariance=covariance, n=n, date=origin.date, source=origin.source)
