"""``calibration/base_<arm>.yaml``, surg_base/1: where an arm's base was measured in the world.

The first arm of a cell keeps the base that ``cell.yaml`` states; it is the reference of the others.
The schema is ``calibration_config.cpp``'s, which the controller reads too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from surg_core._core import parse_base, read_document
from surg_core.config import PathLike
from surg_core.reading.pose_evidence import Evidence, check_measured_with, evidence_text, pose_text
from surg_core.replace_file import exact_numbers, one_line, replace_file, yaml_text
from surg_core.transforms import FloatArray

FORMAT = "surg_base/1"
METHODS = ("touch", "tip", "points")
"""touch: the tip touches the board that the scope sees; tip: the tip as the scope sees it, turn
only; points: both arms' tips touch the same points."""


@dataclass(frozen=True, eq=False)
class BaseCalibration:
    """A measured base.

    Attributes:
        X_WB: (4, 4) the robot base in the world [m].
        method: One of :data:`METHODS`.
        evidence: Of X_WB; the residual in m.
        reference: Name of the cell's first arm, whose stated base it was measured against.
        reference_xyz: (3,) that base, as ``cell.yaml`` stated it then [m].
        reference_rpy: (3,) its roll, pitch, yaw [rad].
        camera_sha256: Of the ``camera_<arm>.yaml`` that it was measured through; ``none``: no
            picture had a part in it.
    """

    X_WB: FloatArray
    method: str
    evidence: Evidence
    reference: str
    reference_xyz: FloatArray
    reference_rpy: FloatArray
    camera_sha256: str


def load_base(path: PathLike) -> BaseCalibration:
    """Read a surg_base/1 file.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    base = parse_base(read_document(path))
    covariance = base.covariance, base.residual, base.n, base.condition
    return BaseCalibration(
        X_WB=base.X_WB,
        method=base.method,
        evidence=Evidence(*covariance, base.date, base.source),
        reference=base.reference,
        reference_xyz=base.reference_xyz,
        reference_rpy=base.reference_rpy,
        camera_sha256=base.camera_sha256,
    )


def write_base(path: PathLike, base: BaseCalibration, note: str) -> None:
    """Write a surg_base/1 file; the old one stays as ``<name>.previous``.

    Args:
        path: Such as ``calibration/base_PSM2.yaml``; its folder must exist.
        base: What to write.
        note: One line for people, put at the top.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    text = (
        f"# {one_line(note)}\n"
        f"format: {FORMAT}\n"
        + pose_text(base.X_WB, "X_WB: the robot base in the world")
        + f"method: {yaml_text(base.method)}\n"
        + evidence_text(base.evidence, "m")
        + f"reference: {yaml_text(base.reference)}  # its base is the one that cell.yaml states\n"
        f"reference_xyz: {exact_numbers(base.reference_xyz)}\n"
        f"reference_rpy: {exact_numbers(base.reference_rpy)}\n"
        f'camera_sha256: "{one_line(base.camera_sha256)}"\n'
    )
    replace_file(Path(path), text, load_base)


def check_base_camera(base: BaseCalibration, file: Path, camera_file: Path) -> None:
    """Refuse a base that was measured through another camera file: it is stale.

    Raises:
        ConfigError: With both files and the cure.
    """
    check_measured_with(
        file,
        (("camera_sha256", base.camera_sha256, camera_file),),
        "the camera has been measured again since",
        "Repeat ./surg calibrate CELL bases, or put back the camera's .previous file. Without "
        f"{file.name} the arm stands where cell.yaml states it",
    )
