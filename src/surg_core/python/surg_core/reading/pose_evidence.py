"""How good a measured pose is, and of which files it was made: the lines of a calibration file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from surg_core._core import ConfigError
from surg_core.config import PathLike
from surg_core.replace_file import exact_number, exact_numbers, exact_rows, one_line
from surg_core.transforms import FloatArray, matrix_to_quaternion_xyzw

NO_HASH = "none"
"""Stands where a file has no part in the result, such as the right lens of a single camera."""
SOURCES = ("measured", "simulated")


@dataclass(frozen=True, eq=False)
class Evidence:
    """How good a measured pose X_AB is.

    Attributes:
        covariance: (6, 6), rotation first [rad^2, rad m, m^2]: of the vector (theta, d) with
            ``R_true = exp([theta]) R`` and ``p_true = p + d``, both in the axes of A.
        residual: Of the fit, rms; its unit is the format's.
        n: Number of views or points.
        condition: Largest over smallest spread of what was observed; 1 is best.
        date: Day of the measurement, such as ``2026-11-23``.
        source: ``measured`` or ``simulated``.
    """

    covariance: FloatArray
    residual: float
    n: int
    condition: float
    date: str
    source: str = "measured"


def file_sha256(path: PathLike) -> str:
    """SHA-256 of a file's bytes, 64 hexadecimal digits.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error


def check_measured_with(
    file: PathLike, stated: Iterable[tuple[str, str, PathLike]], why: str, cure: str
) -> None:
    """Refuse a file of results whose sources have changed since: it is stale.

    Args:
        file: The file of results.
        stated: Key, stated SHA-256 and source of each; no hash or ``none``: no source.
        why: What the change means.
        cure: What to do.

    Raises:
        ConfigError: Of the first source that differs; names both files.
    """
    for key, then, source in stated:
        if then in ("", NO_HASH):
            continue
        now = file_sha256(source) if Path(source).is_file() else "no such file"
        if now != then:
            raise ConfigError(
                f"{file}: {key}: {then[:12]}…; allowed: {now[:12]}, the hash of {source}: {why}. "
                f"{cure}"
            )


def pose_text(X: FloatArray, comment: str) -> str:
    """The lines ``position`` and ``quaternion`` of a pose (4, 4)."""
    return (
        f"position: {exact_numbers(X[:3, 3])}  # m, {one_line(comment)}\n"
        f"quaternion: {exact_numbers(matrix_to_quaternion_xyzw(X[:3, :3]))}  # x, y, z, w\n"
    )


def evidence_text(evidence: Evidence, unit: str) -> str:
    """The lines of :class:`Evidence`; ``unit`` is the residual's."""
    return (
        "# rotation first [rad^2, rad m, m^2], in the axes of the outer frame\n"
        f"covariance: {exact_rows(evidence.covariance)}\n"
        f"residual: {exact_number(evidence.residual)}  # {unit}, rms\n"
        f"n: {evidence.n}\n"
        f"condition: {exact_number(max(evidence.condition, 1.0))}\n"
        f'date: "{one_line(evidence.date)}"\n'
        f"source: {one_line(evidence.source)}\n"
    )
