"""``calibration/camera_<arm>.yaml``: a measured camera in its flange, and how good it is.

Pure: a document in, values out. Where the camera looks decides which way the hand moves the tip, so
a file without evidence is not used, and neither is one with a key that nobody reads.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surg_core import ConfigError, quaternion_xyzw_to_matrix
from surg_core.arm_view import Array

FORMAT = "surg_camera/1"
LEAST_VIEWS = 3
"""Two pairs of postures, turned about different axes, are the least that fix a rotation."""
LARGEST_RESIDUAL = 0.05
"""[rad] rms, 3 degrees; assumed: an operator notices some 10 degrees."""
_ALLOWED = {
    "format": FORMAT,
    "quaternion": "x, y, z, w of the left camera in the flange, of unit length",
    "residual": f"0 to {LARGEST_RESIDUAL:g} [rad], rms of the views' rotations",
    "n": f"number of views, {LEAST_VIEWS} or more",
    "date": 'day of the measurement, "2026-11-21"',
}


@dataclass(frozen=True)
class CameraCalibration:
    """A measured camera."""

    R_FV: Array  # (3, 3) the view frame V, the left camera's optical axes, in the flange F
    residual: float  # of the fit, rms [rad]
    n: int
    date: datetime.date  # when it was measured


def parse(values: Mapping[str, Any], file: str) -> CameraCalibration:
    """The content of a camera's file, checked; `file` is its name for messages.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, key and what is
            allowed.
    """

    def refuse(key: str, why: str) -> ConfigError:
        return ConfigError(f"{file}: {key}: {why}; allowed: {_ALLOWED[key]}")

    if unknown := sorted(set(values) - set(_ALLOWED)):
        raise ConfigError(f"{file}: {unknown[0]}: unknown; allowed: {', '.join(_ALLOWED)}")
    for key in _ALLOWED:
        if key not in values:
            raise refuse(key, "is missing")
    if values["format"] != FORMAT:
        raise refuse("format", repr(values["format"]))
    residual, n = values["residual"], values["n"]
    # Written so that NaN is refused.
    if not _is_number(residual) or not 0.0 <= residual <= LARGEST_RESIDUAL:
        raise refuse("residual", f"{residual!r}")
    if not _is_number(n) or n % 1 != 0 or n < LEAST_VIEWS:
        raise refuse("n", f"{n:g}" if _is_number(n) else f"{n!r}")
    q = values["quaternion"]
    try:
        vector = np.asarray(q, dtype=np.float64)
        good = vector.shape == (4,) and abs(float(np.linalg.norm(vector)) - 1.0) <= 1e-6
    except (TypeError, ValueError):
        good = False
    if not good:
        raise refuse("quaternion", f"{q!r} is not of unit length")
    day = str(values["date"])
    try:
        date = datetime.date.fromisoformat(day)
    except ValueError:
        raise refuse("date", repr(day)) from None
    if date.isoformat() != day:  # some Pythons accept other formats
        raise refuse("date", repr(day))
    return CameraCalibration(quaternion_xyzw_to_matrix(vector), float(residual), int(n), date)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
