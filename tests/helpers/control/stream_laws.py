"""Ways to follow a stream of positions, side by side on a recorded motion, and how they are judged.

A law is a function ``law(t, samples, n)``: samples (m, 3) with their stamps t (m,), increasing from
0; it returns position, velocity and acceleration at the end of each of n ticks of ``TICK`` seconds,
(n, 3, 3). At tick k it may look at the samples with a stamp up to k TICK.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from surg_core import _core
from surg_recording import metrics

Array = NDArray[np.float64]
Law = Callable[[Array, Array, int], Array]

TICK = 0.002
ROUNDING = 1 + 1e-9
PATH_CUTOFF_HZ = 3.0
"""As in the summary of a run: tremor adds length without going anywhere."""


def filter_law(limits: _core.DofLimits, delay: float = 0.0) -> Law:
    """The shipped stream filter behind its estimate."""

    def law(t: Array, samples: Array, n: int) -> Array:
        return _core.stream_filter(t, samples, limits, TICK, delay=delay)[:n]

    return law


@dataclass(frozen=True)
class Verdict:
    """How well a law followed the truth.

    Attributes:
        lag: Shift of least rms [s].
        rms: Of the distance to the truth, without shift [m].
        max: Largest distance [m].
        aligned_rms: At the shift of least rms [m].
        violations: Ticks and axes beyond the limits of (velocity, acceleration, jerk).
        ldlj: Log dimensionless jerk against the truth's, preset "reference" (5 Hz);
            below 0 is rougher.
    """

    lag: float
    rms: float
    max: float
    aligned_rms: float
    violations: tuple[int, int, int]
    ldlj: float


def truth(t: Array, p: Array) -> CubicSpline:
    """The motion between its recorded samples."""
    return CubicSpline(t, p, bc_type="natural")


def play(law: Law, motion: CubicSpline, rate: float) -> Array:
    """What the law makes of the motion sampled at a rate [Hz]."""
    end = float(motion.x[-1])
    stamps = np.arange(int(np.floor(end * rate + 1e-9)) + 1) / rate
    n = int(np.floor(stamps[-1] / TICK + 1e-9))
    return law(stamps, motion(stamps), n)


def judge(out: Array, motion: CubicSpline, limits: _core.DofLimits) -> Verdict:
    """Compare what a law made with the truth."""
    p = out[:, :, 0]
    t = np.arange(1, len(p) + 1) * TICK
    wanted = motion(t)
    distance = np.linalg.norm(p - wanted, axis=1)

    def mean_square(lag: float) -> float:
        inside = (t - lag >= 0) & (t - lag <= motion.x[-1])
        return float(np.mean(np.sum((p[inside] - motion(t[inside] - lag)) ** 2, axis=1)))

    grid = np.arange(-0.05, 0.5, 0.005)
    start = grid[int(np.argmin([mean_square(lag) for lag in grid]))]
    best = minimize_scalar(mean_square, bounds=(start - 0.005, start + 0.005), method="bounded")
    fs = 1 / TICK
    return Verdict(
        lag=float(best.x),
        rms=float(np.sqrt(np.mean(distance**2))),
        max=float(distance.max()),
        aligned_rms=float(np.sqrt(best.fun)),
        violations=violations(out, limits),
        ldlj=metrics.smoothness(p, fs).ldlj - metrics.smoothness(wanted, fs).ldlj,
    )


def violations(states: Array, limits: _core.DofLimits) -> tuple[int, int, int]:
    """Ticks and axes beyond each limit, from the states (n, axes, 3) at the ends of the ticks.

    The jerk of a tick is constant, and the velocity is checked inside the tick too.
    """
    before, after = states[:-1], states[1:]
    j = (after[:, :, 2] - before[:, :, 2]) / TICK
    a = states[:, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = -before[:, :, 2] / j
        peak = before[:, :, 1] - 0.5 * before[:, :, 2] ** 2 / j
    inside = (turn > 0) & (turn < TICK)
    v = np.maximum(np.abs(after[:, :, 1]), np.where(inside, np.abs(peak), 0.0))
    counts = [
        int(np.count_nonzero(np.abs(x) > limit * ROUNDING))
        for x, limit in ((v, limits.velocity), (a, limits.acceleration), (j, limits.jerk))
    ]
    return counts[0], counts[1], counts[2]
