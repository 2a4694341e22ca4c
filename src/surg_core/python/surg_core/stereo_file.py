"""``calibration/endoscope_stereo.yaml``, surg_stereo/1: the right eye in the left one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from surg_core.checked_document import CheckedDocument
from surg_core.config import PathLike
from surg_core.lens_file import DISTORTION_MODELS
from surg_core.reading.pose_evidence import Evidence, check_measured_with, evidence_text, pose_text
from surg_core.replace_file import exact_number, exact_numbers, one_line, replace_file, yaml_text
from surg_core.transforms import FloatArray

FORMAT = "surg_stereo/1"
LEAST_VIEWS = 3
LARGEST_RESIDUAL = 5.0
"""[px] What the reader takes; ``./surg calibrate`` accepts much less."""
BASELINES = (0.0005, 0.05)
"""[m] Of the endoscopes that there are."""
HELD_OUT_DISTANCES = (0.06, 0.08, 0.10)
"""[m] Distances of the board at which the held-out error in space is stated."""
_INTRINSICS = tuple(sorted(4 + n for n in DISTORTION_MODELS.values()))


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The pose between two eyes.

    Attributes:
        X_LR: (4, 4) the right camera in the left camera's optical axes [m].
        evidence: Of X_LR; the residual in px.
        left_sd: (4 + n,) standard deviations of fx, fy, cx, cy [px] and of the n coefficients.
        right_sd: The same of the right lens.
        held_out_px: rms of the corners in views that were not fitted [px].
        held_out: (3,) median error of corners in space [m] at :data:`HELD_OUT_DISTANCES`.
        lens_state: Focus and zoom for people, such as ``focus ring at the mark``.
        board: What was seen, such as ``charuco 11x8, 5 mm``.
        left_sha256: Of ``endoscope_left.yaml``.
        right_sha256: Of ``endoscope_right.yaml``.
    """

    X_LR: FloatArray
    evidence: Evidence
    left_sd: FloatArray
    right_sd: FloatArray
    held_out_px: float
    held_out: FloatArray
    lens_state: str
    board: str
    left_sha256: str
    right_sha256: str

    @property
    def baseline(self) -> float:
        """Of the right eye along the left eye's x [m]."""
        return float(self.X_LR[0, 3])


def load_stereo(path: PathLike) -> StereoCalibration:
    """Read a surg_stereo/1 file.

    Raises:
        ConfigError: A key is missing, unknown or out of its range, or the eyes are swapped.
    """
    doc = CheckedDocument.read(path)
    doc.choice("format", (FORMAT,))
    X_LR = doc.pose(0.2)
    found = StereoCalibration(
        X_LR=X_LR,
        evidence=doc.evidence(LEAST_VIEWS, LARGEST_RESIDUAL, "px"),
        left_sd=_deviations(doc, "left_sd"),
        right_sd=_deviations(doc, "right_sd"),
        held_out_px=doc.number("held_out_px", 0.0, LARGEST_RESIDUAL, "px"),
        held_out=doc.numbers("held_out", len(HELD_OUT_DISTANCES), 0.1, "m"),
        lens_state=doc.text("lens_state", "focus and zoom in words"),
        board=doc.text("board", "the board in words"),
        left_sha256=doc.sha256("left_sha256"),
        right_sha256=doc.sha256("right_sha256"),
    )
    doc.finish()
    low, high = BASELINES
    if not low <= found.baseline <= high:
        why = "the eyes are swapped" if -high <= found.baseline <= -low else "is no baseline"
        raise doc.refusal(
            "position",
            f"x is {1e3 * found.baseline:g} mm: {why}",
            f"{1e3 * low:g} to {1e3 * high:g} mm, the right eye on the right",
            "Exchange the cables (or set endoscope.swap in cell.yaml) and repeat ./surg calibrate "
            "CELL stereo",
        )
    return found


def write_stereo(path: PathLike, stereo: StereoCalibration, note: str) -> None:
    """Write a surg_stereo/1 file; the old one stays as ``<name>.previous``.

    Args:
        path: ``calibration/endoscope_stereo.yaml``; its folder must exist.
        stereo: What to write; the hashes are those of the lens files as written.
        note: One line for people, put at the top.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    text = (
        f"# {one_line(note)}\n"
        f"format: {FORMAT}\n"
        + pose_text(stereo.X_LR, "X_LR: the right camera in the left one's optical axes")
        + evidence_text(stereo.evidence, "px")
        + f"left_sd: {exact_numbers(stereo.left_sd)}  # of fx, fy, cx, cy [px], coefficients\n"
        f"right_sd: {exact_numbers(stereo.right_sd)}\n"
        f"held_out_px: {exact_number(stereo.held_out_px)}  # rms\n"
        f"held_out: {exact_numbers(stereo.held_out)}  # m, median at 0.06, 0.08, 0.10 m\n"
        f"lens_state: {yaml_text(one_line(stereo.lens_state))}\n"
        f"board: {yaml_text(one_line(stereo.board))}\n"
        f'left_sha256: "{one_line(stereo.left_sha256)}"\n'
        f'right_sha256: "{one_line(stereo.right_sha256)}"\n'
    )
    replace_file(Path(path), text, load_stereo)


def check_lenses(
    stereo: StereoCalibration, file: PathLike, left_file: PathLike, right_file: PathLike
) -> None:
    """Refuse a stereo file that was not measured with these two lens files.

    Raises:
        ConfigError: A lens file has changed since; names both files and the cure.
    """
    check_measured_with(
        file,
        (
            ("left_sha256", stereo.left_sha256, left_file),
            ("right_sha256", stereo.right_sha256, right_file),
        ),
        "they were not measured together",
        "Repeat ./surg calibrate CELL stereo, or put back the .previous files",
    )


def _deviations(doc: CheckedDocument, key: str) -> FloatArray:
    sd = doc.numbers(key, _INTRINSICS, 1e6, "")
    if not (sd >= 0.0).all():
        raise doc.refusal(key, f"holds {sd.min():g}", "standard deviations, 0 or more")
    return sd
