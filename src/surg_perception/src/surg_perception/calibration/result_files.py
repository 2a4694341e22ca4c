"""From solutions to the files in ``calibration/``, by the formats of ``surg_core``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surg_core import ConfigError
from surg_core.camera_file import camera_calibration, write_camera
from surg_core.lens_file import Lens, load_lens, write_lens
from surg_core.pictures.lens_model import LensModel
from surg_core.reading.pose_evidence import NO_HASH, Evidence, file_sha256
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
from surg_perception.calibration.intrinsics import LensFit
from surg_perception.calibration.lens_covariance import (
    CURE,
    LensCovariance,
    lens_covariance,
    write_lens_covariance,
)
from surg_perception.calibration.stereo import StereoFit
from surg_perception.calibration.triangulation import Rectified, Stereo

LEFT, RIGHT, STEREO = "endoscope_left.yaml", "endoscope_right.yaml", "endoscope_stereo.yaml"
COVARIANCE = "endoscope_covariance.yaml"


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
    known = LensCovariance(result.fit.covariance, content.left_sha256, content.right_sha256)
    write_lens_covariance(folder / COVARIANCE, known, origin.note)
    return [*paths, folder / COVARIANCE]


def _lens(name: str, lens: LensModel, R: FloatArray, P: FloatArray) -> Lens:
    return Lens(*lens.size, name, lens.K, lens.model, lens.D, R, P)


def check_one_eye(folder: Path) -> None:
    """Refuse to measure the left eye alone where a cell has two.

    Raises:
        ConfigError: The cell has files of a second eye.
    """
    for name in (RIGHT, STEREO):
        if (folder / name).exists():
            raise ConfigError(
                f"{folder / name}: this cell has two eyes; run ./surg calibrate CELL stereo. For "
                f"one eye delete {RIGHT} and {STEREO} first"
            )


def save_camera(folder: Path, result: LensFit, origin: Origin) -> list[Path]:
    """Write the lens of a single eye."""
    lens, paths = result.lens, [folder / LEFT, folder / COVARIANCE]
    P = np.column_stack([lens.K, np.zeros(3)])
    write_lens(paths[0], _lens(Path(LEFT).stem, lens, np.eye(3), P), origin.note)
    known = LensCovariance(result.fit.covariance, file_sha256(paths[0]))
    write_lens_covariance(paths[1], known, origin.note)
    return paths


def read_lens_covariance(folder: Path) -> FloatArray | None:
    """How well the eyes of a cell's ``calibration`` folder are known, as `lens_covariance`."""
    file = folder / COVARIANCE
    found = lens_covariance(file, folder / LEFT, folder / RIGHT)
    if found is None:
        return None
    n = len(LensModel.of(load_lens(folder / LEFT)).values)
    m = 2 * n + 6 if (folder / RIGHT).exists() else n
    if len(found) != m:
        raise ConfigError(
            f"{file}: covariance: is {len(found)} x {len(found)}; allowed: {m} x {m}, the lens has "
            f"{n} values. {CURE}, or delete this file"
        )
    return found


def read_eyes(folder: Path) -> tuple[Stereo, StereoCalibration | None]:
    """The eyes that a cell's ``calibration`` folder has: two, or the left one alone.

    With one eye the right one of the result is the left one again, and the second value is None.

    Raises:
        ConfigError: As `read_stereo`.
    """
    if (folder / STEREO).exists() or (folder / RIGHT).exists() or not (folder / LEFT).exists():
        return read_stereo(folder)
    lens = LensModel.of(load_lens(folder / LEFT))
    return Stereo(lens, lens, np.eye(4)), None


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
    eyes = [folder / name for name in (LEFT, RIGHT)]
    left, right = (file_sha256(path) if path.exists() else NO_HASH for path in eyes)
    of_views = None if result.lens_share is None else result.of_views
    camera = camera_calibration(result.X_FV, evidence, left, right, of_views)
    path = folder / f"camera_{arm}.yaml"
    write_camera(path, camera, origin.note)
    return path


def save_page(folder: Path, step: str, page: str) -> Path:
    """Write the page about a step into ``views`` of a cell's ``calibration`` folder."""
    path = folder / "views" / f"{step}.html"
    path.parent.mkdir(exist_ok=True)
    path.write_text(page, encoding="utf-8")
    return path
