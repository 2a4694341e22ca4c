"""Streams for the followers, and how well they were followed."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

FloatArray = npt.NDArray[np.float64]
PERIOD = 0.002
LIMITS = (0.25, 2.0, 40.0)  # tip, per axis [m/s, m/s^2, m/s^3]
RATES = (30, 500)  # [Hz]


def read_motion(file: Path) -> CubicSpline:
    """A recorded motion (columns ``t_s, x_m, y_m, z_m``) as a cubic spline, the truth."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = [
            [float(row[key]) for key in ("t_s", "x_m", "y_m", "z_m")]
            for row in csv.DictReader(line for line in stream if not line.startswith("#"))
        ]
    table = np.asarray(rows)
    return CubicSpline(table[:, 0] - table[0, 0], table[:, 1:])


def halves(motion: CubicSpline) -> tuple[CubicSpline, CubicSpline]:
    """The first half of a motion, to tune on, and the second, to judge by; each from t = 0."""
    middle = len(motion.x) // 2
    at = motion(motion.x)

    def part(rows: slice) -> CubicSpline:
        return CubicSpline(motion.x[rows] - motion.x[rows][0], at[rows])

    return part(slice(None, middle)), part(slice(middle, None))


def write(truth: CubicSpline, rate: int, folder: Path) -> None:
    """`samples` (rows of t, x, y, z) at a rate and `truth` at every tick, raw doubles."""
    folder.mkdir(parents=True, exist_ok=True)
    end = float(truth.x[-1])
    t = np.arange(int(end * rate) + 1) / rate
    np.column_stack([t, truth(t)]).tofile(folder / "samples")
    truth(np.arange(int(end / PERIOD) + 1) * PERIOD).tofile(folder / "truth")


def judge(truth: CubicSpline, path_file: Path) -> dict[str, Any]:
    """Lag and deviations of a follower's path.

    Args:
        truth: The motion.
        path_file: Positions at (k + 1) T, raw doubles.

    Returns:
        ``lag_ms``: shift of least rms; ``rms_mm`` without shift; ``aligned_rms_mm``,
        ``aligned_p95_mm``, ``aligned_max_mm`` with it.
    """
    path = np.fromfile(path_file).reshape(-1, 3)
    t = (np.arange(len(path)) + 1) * PERIOD
    keep = t > 1.0  # every follower starts at rest

    def distance(shift: float) -> FloatArray:
        at = np.clip(t[keep] - shift, 0, truth.x[-1])
        return np.asarray(np.linalg.norm(path[keep] - truth(at), axis=1))

    def rms(shift: float) -> float:
        return float(np.sqrt(np.mean(distance(shift) ** 2)))

    coarse = np.arange(-0.02, 0.5, 0.005)
    best = float(coarse[np.argmin([rms(s) for s in coarse])])
    lag = float(minimize_scalar(rms, bounds=(best - 0.005, best + 0.005), method="bounded").x)
    aligned = distance(lag)
    return {
        "lag_ms": 1e3 * lag,
        "rms_mm": 1e3 * rms(0.0),
        "aligned_rms_mm": 1e3 * rms(lag),
        "aligned_p95_mm": 1e3 * float(np.percentile(aligned, 95)),
        "aligned_max_mm": 1e3 * float(aligned.max()),
    }
