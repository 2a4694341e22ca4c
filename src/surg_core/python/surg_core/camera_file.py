"""``calibration/camera_<arm>.yaml``: the left camera of an endoscope in the flange of its arm.

surg_camera/2 states the pose with its covariance. surg_camera/1 states the rotation only: enough
to map a hand into the picture, not to draw into it. Where the camera looks decides which way the
hand moves the tip, so a file without evidence is not used.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from surg_core._core import ConfigError, Document, read_document
from surg_core.checked_document import CheckedDocument
from surg_core.config import PathLike
from surg_core.reading.pose_evidence import (
    NO_HASH,
    Evidence,
    check_measured_with,
    evidence_text,
    pose_text,
)
from surg_core.replace_file import exact_rows, one_line, replace_file
from surg_core.transforms import FloatArray

FORMATS = ("surg_camera/1", "surg_camera/2")
LEAST_VIEWS = 3
"""Two pairs of postures, turned about different axes, are the least that fix a rotation."""
LARGEST_RESIDUAL = 0.05
"""[rad] rms, 3 degrees, of surg_camera/1; assumed: an operator notices some 10 degrees."""
LARGEST_PIXELS = 5.0
"""[px] rms, of surg_camera/2. What the reader takes; ``./surg calibrate`` accepts much less."""
LARGEST_OFFSET = 1.5
"""[m] Of the camera from the flange, each axis."""


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A measured camera.

    Attributes:
        R_FV: (3, 3) the view frame V, the left camera's optical axes, in the flange F.
        X_FV: (4, 4) its pose [m]; None: the file is surg_camera/1 and states the rotation only.
        residual: Of the fit, rms: [px] with X_FV, else [rad].
        n: Number of views.
        date: Day of the measurement, such as ``2026-11-23``.
        evidence: With the covariance of X_FV; None for surg_camera/1.
        left_sha256: Of the left lens file that it was measured with; empty for surg_camera/1.
        right_sha256: Of the right one; ``none`` with a single camera.
        of_views: Covariance (6, 6) of X_FV without what the lenses cause; None: not stated.
    """

    R_FV: FloatArray
    X_FV: FloatArray | None
    residual: float
    n: int
    date: str
    evidence: Evidence | None = None
    left_sha256: str = ""
    right_sha256: str = ""
    of_views: FloatArray | None = None

    @property
    def through_lenses(self) -> FloatArray | None:
        """Covariance (6, 6) for points that are seen through the same lenses.

        An error of a lens turns and shifts the pose so that what is seen stays in its place.
        """
        stated = None if self.evidence is None else self.evidence.covariance
        return stated if self.of_views is None else self.of_views


def camera_calibration(
    X_FV: FloatArray,
    evidence: Evidence,
    left_sha256: str,
    right_sha256: str = NO_HASH,
    of_views: FloatArray | None = None,
) -> CameraCalibration:
    """A camera for surg_camera/2; arguments as in :class:`CameraCalibration`."""
    return CameraCalibration(
        X_FV[:3, :3],
        X_FV,
        evidence.residual,
        evidence.n,
        evidence.date,
        evidence,
        left_sha256,
        right_sha256,
        of_views,
    )


def parse_camera(document: Document) -> CameraCalibration:
    """The content of a camera's file of either version, checked.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    doc = CheckedDocument(document)
    if doc.choice("format", FORMATS) == "surg_camera/2":
        X_FV = doc.pose(LARGEST_OFFSET)
        evidence = doc.evidence(LEAST_VIEWS, LARGEST_PIXELS, "px")
        lenses = doc.sha256("left_sha256"), doc.sha256("right_sha256", optional=True)
        key = "covariance_of_views"
        found = camera_calibration(
            X_FV, evidence, *lenses, doc.covariance(key) if doc.has(key) else None
        )
    else:
        found = CameraCalibration(
            R_FV=doc.rotation(),
            X_FV=None,
            residual=doc.number("residual", 0.0, LARGEST_RESIDUAL, "rad"),
            n=doc.count("n", LEAST_VIEWS),
            date=doc.date(),
        )
    doc.finish()
    return found


def load_camera(path: PathLike) -> CameraCalibration:
    """Read ``camera_<arm>.yaml``; errors as :func:`parse_camera`."""
    return parse_camera(read_document(path))


def write_camera(path: PathLike, camera: CameraCalibration, note: str) -> None:
    """Write a surg_camera/2 file; the old one stays as ``<name>.previous``.

    Args:
        path: Such as ``calibration/camera_ECM.yaml``; its folder must exist.
        camera: What to write, with pose and evidence.
        note: One line for people, put at the top.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    if camera.X_FV is None or camera.evidence is None:
        raise ConfigError(f"{path}: position: is missing; surg_camera/2 states the whole pose")
    rows = "" if camera.of_views is None else exact_rows(camera.of_views)
    text = (
        f"# {one_line(note)}\n"
        "format: surg_camera/2\n"
        + pose_text(camera.X_FV, "X_FV: the left camera's optical axes in the flange")
        + evidence_text(camera.evidence, "px")
        + (f"covariance_of_views: {rows}\n" if rows else "")
        + f'left_sha256: "{one_line(camera.left_sha256)}"  # of endoscope_left.yaml\n'
        f'right_sha256: "{one_line(camera.right_sha256)}"\n'
    )
    replace_file(Path(path), text, load_camera)


def check_camera_lenses(
    camera: CameraCalibration, file: PathLike, left_file: Path, right_file: Path
) -> None:
    """Refuse a surg_camera/2 file whose lens files have changed: it is stale.

    Raises:
        ConfigError: With both files and the cure.
    """
    check_measured_with(
        file,
        (
            ("left_sha256", camera.left_sha256, left_file),
            ("right_sha256", camera.right_sha256, right_file),
        ),
        "the lens has been measured again since",
        "Repeat ./surg calibrate CELL handeye, or put back the lens's .previous file",
    )
