"""``calibration/endoscope_covariance.yaml``: how well the lenses are known, for later steps.

The values of one lens go together, as those of both do: a longer focal length with a board that is
farther away looks alike. Standard deviations of single values would not do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from surg_core import ConfigError
from surg_core.checked_document import CheckedDocument
from surg_core.lens_file import DISTORTION_MODELS
from surg_core.reading.pose_evidence import NO_HASH, check_measured_with
from surg_core.replace_file import exact_rows, one_line, replace_file
from surg_core.transforms import FloatArray

FORMAT = "surg_lens_covariance/1"
_VALUES = tuple(sorted(4 + n for n in DISTORTION_MODELS.values()))
_LARGEST = 1e6
"""Of any entry; its square root is 1,000 px."""
_SINGULAR = -1e-6
"""Least eigenvalue: a jackknife over fewer views than values is singular."""
CURE = "Repeat ./surg calibrate CELL stereo (one eye: camera)"


@dataclass(frozen=True, eq=False)
class LensCovariance:
    """Of one or two eyes.

    Attributes:
        covariance: (m, m) of fx, fy, cx, cy [px] and the coefficients of the left lens; with two
            eyes then of the right lens, and of X_LR: turn [rad], shift [m], axes of the left eye.
            By jackknife over views, so its rank may be below m.
        left_sha256: Of ``endoscope_left.yaml``.
        right_sha256: Of ``endoscope_right.yaml``; ``none`` with one eye.
    """

    covariance: FloatArray
    left_sha256: str
    right_sha256: str = NO_HASH


def load_lens_covariance(path: Path) -> LensCovariance:
    """Read a surg_lens_covariance/1 file.

    Raises:
        ConfigError: A key is missing, unknown or out of its range.
    """
    doc = CheckedDocument.read(path)
    doc.choice("format", (FORMAT,))
    left, right = doc.sha256("left_sha256"), doc.sha256("right_sha256", optional=True)
    sides = _VALUES if right == NO_HASH else tuple(2 * n + 6 for n in _VALUES)
    C = doc.any_covariance("covariance", sides, _LARGEST, _SINGULAR, CURE)
    doc.finish()
    return LensCovariance(C, left, right)


def write_lens_covariance(path: Path, found: LensCovariance, note: str) -> None:
    """Write the file; the old one stays as ``<name>.previous``.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    symmetric = (found.covariance + found.covariance.T) / 2.0
    text = (
        f"# {one_line(note)}\n"
        f"format: {FORMAT}\n"
        f'left_sha256: "{found.left_sha256}"\n'
        f'right_sha256: "{found.right_sha256}"\n'
        "# of each lens fx, fy, cx, cy [px] and its coefficients; then X_LR [rad, m]\n"
        f"covariance: {exact_rows(symmetric)}\n"
    )
    replace_file(path, text, load_lens_covariance)


def lens_covariance(path: Path, left_file: Path, right_file: Path) -> FloatArray | None:
    """The covariance (m, m) of the lenses in these files; None: nobody has measured it.

    Raises:
        ConfigError: The file is invalid, or belongs to other lenses.
    """
    if not path.exists():
        return None
    found = load_lens_covariance(path)
    if (found.right_sha256 == NO_HASH) != (not right_file.exists()):
        raise ConfigError(
            f"{path}: right_sha256: {found.right_sha256[:12]}; allowed: a hash where there is "
            f"{right_file.name}, else {NO_HASH}. {CURE}, or delete this file"
        )
    check_measured_with(
        path,
        (
            ("left_sha256", found.left_sha256, left_file),
            ("right_sha256", found.right_sha256, right_file),
        ),
        "they were not measured together",
        f"{CURE}, or delete this file: then the stated error of the hand-eye pose leaves out the "
        "lens",
    )
    return found.covariance
