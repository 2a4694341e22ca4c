"""Filters and grids that bring a motion to the rate of a metric, and percentiles."""

from __future__ import annotations

import math

import numpy as np
from scipy import signal

from surg_recording.metrics._types import Array, ArrayLike


def uniform(t: ArrayLike, values: ArrayLike, fs: float) -> tuple[Array, Array]:
    """The uniform grid (M,) of rate fs [Hz] from t[0], and linearly interpolated values on it.

    ``t`` (N,) increases [s]; ``values`` are (N,) or (N, D).
    """
    times, v = np.asarray(t, dtype=float), np.asarray(values, dtype=float)
    count = math.floor((times[-1] - times[0]) * fs + 1e-6) + 1
    grid = times[0] + np.arange(count) / fs
    return grid, interpolate(grid, times, v)


def interpolate(grid: ArrayLike, t: ArrayLike, values: ArrayLike) -> Array:
    """Linear interpolation of (N,) or (N, D) samples; the ends are held."""
    at, times = np.asarray(grid, dtype=float), np.asarray(t, dtype=float)
    v = np.asarray(values, dtype=float)
    if v.ndim == 1:
        return np.asarray(np.interp(at, times, v))
    return np.stack([np.interp(at, times, column) for column in v.T], axis=1)


def differentiate(values: ArrayLike, fs: float) -> Array:
    """Central differences of uniform (N, D) samples, one-sided at the ends [1/s]."""
    v = np.asarray(values, dtype=float)
    return np.zeros_like(v) if len(v) < 2 else np.asarray(np.gradient(v, 1.0 / fs, axis=0))


def low_pass(values: ArrayLike, fs: float, cutoff: float, order: int = 4) -> Array:
    """Zero-phase Butterworth low-pass along the first axis.

    Applied forwards and backwards, so the attenuation at ``cutoff`` [Hz] is 6 dB. Motions too short
    for the filter's padding (about half a period) are returned unchanged.
    """
    v = np.asarray(values, dtype=float)
    if cutoff >= fs / 2:
        return v.copy()
    sections = signal.butter(order, cutoff, fs=fs, output="sos")
    # The filter rings for about one period of the cut-off: that much odd extension at both ends.
    padding = min(len(v) - 1, math.ceil(2.0 * fs / cutoff))
    if len(v) < max(9, fs / cutoff / 2):
        return v.copy()
    return np.asarray(signal.sosfiltfilt(sections, v, axis=0, padlen=padding))


def downsample(
    velocity: ArrayLike, fs: float, target_fs: float, *, cutoff: float | None = None, order: int = 8
) -> Array:
    """Anti-aliased downsampling of a velocity vector (N, D), before any norm is taken.

    Zero-phase Butterworth, by default at 0.4 of the new rate, then linear interpolation on the new
    grid. Taking every n-th sample instead would fold tremor into the band and change LDLJ by 2.

    Raises:
        ValueError: ``target_fs`` is above ``fs`` [Hz].
    """
    if target_fs > fs * (1.0 + 1e-9):
        raise ValueError(f"downsample: {fs:g} Hz cannot be brought to {target_fs:g} Hz")
    v = np.asarray(velocity, dtype=float)
    if len(v) < 2:
        return v.copy()
    smooth = low_pass(v, fs, 0.4 * target_fs if cutoff is None else cutoff, order)
    return uniform(np.arange(len(v)) / fs, smooth, target_fs)[1]


def stride(values: ArrayLike, fs: float, target_fs: float) -> Array:
    """The samples nearest to a slower grid, without a filter: aliasing included."""
    v = np.asarray(values, dtype=float)
    if target_fs > fs * (1.0 + 1e-9):
        raise ValueError(f"stride: {fs:g} Hz cannot be brought to {target_fs:g} Hz")
    count = math.floor((len(v) - 1) * target_fs / fs + 1e-9) + 1 if len(v) else 0
    return np.asarray(v[np.rint(np.arange(count) * fs / target_fs).astype(int)])


def percentiles(values: ArrayLike, *levels: float) -> list[float]:
    """Percentiles (0–100, linear interpolation) of the finite values; NaN without any."""
    v = np.asarray(values, dtype=float)
    v = v[np.isfinite(v)]
    if v.size == 0:
        return [math.nan] * len(levels)
    return [float(x) for x in np.percentile(v, levels)]
