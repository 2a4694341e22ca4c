"""From solutions to the files in ``calibration/``, by the formats of ``surg_core``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surg_core.camera_file import camera_calibration, write_camera
from surg_core.checked_document import Evidence, file_sha256
from surg_core.lens_file import Lens, load_lens, write_lens
from surg_core.stereo_file import (
    HELD_OUT_DISTANCES,
    StereoCalibration,
    check_lenses,
    load_stereo,
    write_stereo,
)
from surg_core.transforms import FloatArray
from surg_perception.calibration.board import Board
from surg_perception.calibration.handeye import HandEyeFit
from surg_perception.calibration.lens_model import LensModel
from surg_perception.calibration.stereo import StereoFit
from surg_perception.calibration.triangulation import Rectified, Stereo

LEFT, RIGHT, STEREO = "endoscope_left.yaml", "endoscope_right.yaml", "endoscope_stereo.yaml"


@dataclass(frozen=True)
class Origin:
    """Where a result comes from.

    Attributes:
        note: One line for people, put at the top of the file.
        date: Such as ``2026-11-23``.
        source: ``measured`` or ``simulated``.
    """

    note: str
    date: str
    source: str


def save_stereo(
    folder: Path, result: StereoFit, board: Board, lens_state: str, origin: Origin
) -> list[Path]:
    """Write both lenses and the pose between them into a cell's ``calibration`` folder."""
    stereo = result.stereo
    rectified = Rectified.of(stereo)
    paths = [folder / LEFT, folder / RIGHT, folder / STEREO]
    for path, lens, R, P in zip(
        paths,
        (stereo.left, stereo.right),
        (rectified.R_left, rectified.R_right),
        rectified.P,
        strict=False,
    ):
        write_lens(path, _lens(path.stem, lens, R, P), origin.note)
    fit, (left_sd, right_sd) = result.fit, result.spreads
    evidence = Evidence(
        result.covariance, fit.rms, len(fit.residuals), max(1.0, fit.condition), origin.date,
        origin.source,
    )  # fmt: skip
    square = f"{1e3 * board.square:g} mm, {board.dictionary}"
    content = StereoCalibration(
        X_LR=stereo.X_LR,
        evidence=evidence,
        left_sd=left_sd,
        right_sd=right_sd,
        held_out_px=result.held_out,
        held_out=np.array([result.error_at(z) for z in HELD_OUT_DISTANCES]),
        lens_state=lens_state or "not stated",
        board=f"charuco {board.columns}x{board.rows}, {square}",
        left_sha256=file_sha256(paths[0]),
        right_sha256=file_sha256(paths[1]),
    )
    write_stereo(paths[2], content, origin.note)
    return paths


def _lens(name: str, lens: LensModel, R: FloatArray, P: FloatArray) -> Lens:
    return Lens(*lens.size, name, lens.K, lens.model, lens.D, R, P)


def read_stereo(folder: Path) -> tuple[Stereo, StereoCalibration]:
    """Both lenses and the pose between them from a cell's ``calibration`` folder.

    Raises:
        ConfigError: A file is missing or invalid, or they were not measured together.
    """
    left, right = folder / LEFT, folder / RIGHT
    content = load_stereo(folder / STEREO)
    check_lenses(content, folder / STEREO, left, right)
    lenses = [LensModel.of(load_lens(path)) for path in (left, right)]
    return Stereo(lenses[0], lenses[1], np.array(content.X_LR)), content


def save_handeye(folder: Path, arm: str, result: HandEyeFit, origin: Origin) -> Path:
    """Write the camera of an arm with the hashes of the lens files that it was measured with."""
    fit = result.fit
    evidence = Evidence(
        result.covariance, fit.rms, len(fit.residuals), max(1.0, fit.condition), origin.date,
        origin.source,
    )  # fmt: skip
    hashes = [file_sha256(folder / name) for name in (LEFT, RIGHT)]
    path = folder / f"camera_{arm}.yaml"
    write_camera(path, camera_calibration(result.X_FV, evidence, *hashes), origin.note)
    return path
