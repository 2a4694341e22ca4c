"""The numbers of the paper and those beside them: functions from arrays to values, SI units.

Smoothness: S. Balasubramanian, A. Melendez-Calderon, E. Burdet, "A robust and sensitive metric for
quantifying movement smoothness", IEEE TBME 59(8), 2012, and S. Balasubramanian et al., "On the
analysis of movement smoothness", J. NeuroEng. Rehabil. 12:112, 2015. Which of the many variants a
value is, its ``SmoothnessPreset`` says; values of different presets are never compared.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
from scipy import optimize, signal, spatial

Array = npt.NDArray[np.float64]
ArrayLike = npt.ArrayLike


# --- distance between pivot and shaft -----------------------------------------------------------


def rcm_deviation(p_BShaft: ArrayLike, s_B: ArrayLike, p_BRcm: ArrayLike) -> Array:
    """Distance from the pivot to the infinite shaft line, per sample.

    Args:
        p_BShaft: (N, 3) any point of the shaft [m].
        s_B: (N, 3) direction of the shaft, of any length but zero.
        p_BRcm: (N, 3) or (3,) the pivot [m].

    Returns:
        (N,) distances [m]; NaN where the direction has no length or a value is not finite.

    Raises:
        ValueError: when the shapes do not fit.
    """
    point, axis = _rows3(p_BShaft, "p_BShaft"), _rows3(s_B, "s_B")
    pivot = np.asarray(p_BRcm, dtype=float)
    pivot = np.broadcast_to(pivot, point.shape) if pivot.shape == (3,) else _rows3(pivot, "p_BRcm")
    if not point.shape == axis.shape == pivot.shape:
        raise ValueError(
            f"rcm_deviation: shapes {point.shape}, {axis.shape} and {pivot.shape} differ;"
            " all must be (N, 3)"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        s = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        return np.asarray(np.linalg.norm(np.cross(pivot - point, s), axis=1))


# --- smoothness ---------------------------------------------------------------------------------


def sparc(
    speed: ArrayLike,
    fs: float,
    *,
    fc: float | None = None,
    amplitude_threshold: float = 0.05,
    padlevel: int = 4,
    mirrored: bool = False,
) -> float:
    """Spectral arc length of a speed profile: 0 at best, more negative when less smooth.

    The arc of the speed's amplitude spectrum, normalised by its peak, up to the cut-off or the last
    frequency whose amplitude reaches the threshold.

    Args:
        speed: (N,) speed; its unit does not matter.
        fs: sampling rate [Hz].
        fc: cut-off [Hz]; default min(10, fs/2). More than fs/2 is cut to fs/2, because beyond it
            the spectrum is only a mirror image that would be counted a second time.
        amplitude_threshold: of the normalised spectrum.
        padlevel: zero padding to 2^(ceil(log2 N) + padlevel) samples.
        mirrored: keep that mirror image, as the published reference code does when fc > fs/2.
            Only to reproduce its numbers.

    Returns:
        The arc length (≤ 0); NaN without motion or with fewer than 2 samples.

    Raises:
        ValueError: not one-dimensional, not finite, or fs, fc or padlevel out of range.
    """
    v = _finite(speed, "sparc: speed")
    if v.ndim != 1:
        raise ValueError(f"sparc: speed has shape {v.shape}, must be (N,)")
    _positive(fs, "sparc: fs")
    if padlevel < 0:
        raise ValueError(f"sparc: padlevel is {padlevel}, must be ≥ 0")
    cutoff = 10.0 if fc is None else _positive(fc, "sparc: fc")
    if not mirrored:
        cutoff = min(cutoff, fs / 2)
    if v.size < 2 or not np.any(v):
        return math.nan
    n = 2 ** (math.ceil(math.log2(v.size)) + padlevel)
    amplitude = np.abs(np.fft.fft(v / np.max(np.abs(v)), n))
    amplitude /= np.max(amplitude)
    frequency = np.arange(n) * (fs / n)
    band = frequency <= cutoff
    frequency, amplitude = frequency[band], amplitude[band]
    loud = np.flatnonzero(amplitude >= amplitude_threshold)
    if loud.size == 0:
        return math.nan
    frequency = frequency[loud[0] : loud[-1] + 1]
    amplitude = amplitude[loud[0] : loud[-1] + 1]
    width = frequency[-1] - frequency[0]
    if width <= 0.0:
        return 0.0
    return -float(np.sum(np.hypot(np.diff(frequency) / width, np.diff(amplitude))))


def ldlj(velocity: ArrayLike, fs: float) -> float:
    """Log dimensionless jerk from velocity: more negative when less smooth.

    −ln( T³/v_peak² · Σ ‖Δ²v/Δt²‖² Δt ) with T = N Δt. ``fs`` cancels out: only the number of
    samples and the shape of the motion count.

    Args:
        velocity: (N,) the scalar speed form, or (N, D) the vector form: jerk vector, peak of the
            speed ‖v‖.
        fs: sampling rate [Hz].

    Returns:
        The value; NaN without motion, without jerk or with fewer than 3 samples.

    Raises:
        ValueError: neither (N,) nor (N, D), not finite, or fs not positive.
    """
    v = _finite(velocity, "ldlj: velocity")
    if v.ndim not in (1, 2):
        raise ValueError(f"ldlj: velocity has shape {v.shape}, must be (N,) or (N, D)")
    _positive(fs, "ldlj: fs")
    if len(v) < 3:
        return math.nan
    v = v.reshape(len(v), -1)
    peak = float(np.max(np.linalg.norm(v, axis=1)))
    if peak == 0.0:
        return math.nan
    # In units of the sampling step and the peak speed, so that nothing over- or underflows.
    jerk = np.diff(v / peak, n=2, axis=0)
    total = float(len(v)) ** 3 * float(np.sum(jerk**2))
    return -math.log(total) if total > 0.0 else math.nan


def ldlj_displacement(position: ArrayLike, fs: float) -> float:
    """Log dimensionless jerk over the peak displacement, the variant behind the paper's figures.

    −ln( T⁵/A² · Σ ‖Δ³p/Δt³‖² Δt ), A the largest distance from the first sample, T = N Δt. Another
    metric than ``ldlj``: the two must not stand in one figure.

    Args:
        position: (N, D) positions [m].
        fs: sampling rate [Hz].

    Returns:
        The value; NaN without motion, without jerk or with fewer than 4 samples.

    Raises:
        ValueError: not (N, D), not finite, or fs not positive.
    """
    p = _finite(position, "ldlj_displacement: position")
    if p.ndim != 2:
        raise ValueError(f"ldlj_displacement: position has shape {p.shape}, must be (N, D)")
    _positive(fs, "ldlj_displacement: fs")
    if len(p) < 4:
        return math.nan
    amplitude = float(np.max(np.linalg.norm(p - p[0], axis=1)))
    if amplitude == 0.0:
        return math.nan
    jerk = np.diff((p - p[0]) / amplitude, n=3, axis=0)
    total = float(len(p)) ** 5 * float(np.sum(jerk**2))
    return -math.log(total) if total > 0.0 else math.nan


@dataclasses.dataclass(frozen=True)
class SmoothnessPreset:
    """Every choice that a smoothness value depends on."""

    name: str
    fs: float
    """Rate the motion is brought to [Hz]."""
    downsampling: str
    """``antialiased``: zero-phase low-pass of the velocity; ``strided``: every n-th sample."""
    sparc_fc: float
    sparc_padlevel: int
    sparc_amplitude_threshold: float
    ldlj_form: str
    """``velocity_vector`` is ``ldlj``, ``displacement`` is ``ldlj_displacement``."""

    def parameters(self) -> dict[str, str | float | int]:
        """All fields, for a label or a file."""
        return dataclasses.asdict(self)

    def label(self) -> str:
        """One line for a figure."""
        return (
            f"preset {self.name}: {self.fs:g} Hz {self.downsampling},"
            f" SPARC fc {self.sparc_fc:g} Hz, padlevel {self.sparc_padlevel},"
            f" threshold {self.sparc_amplitude_threshold:g}, LDLJ {self.ldlj_form}"
        )


PRESETS: dict[str, SmoothnessPreset] = {
    "reference": SmoothnessPreset("reference", 5.0, "antialiased", 2.5, 4, 0.05, "velocity_vector"),
    "paper": SmoothnessPreset("paper", 5.0, "strided", 2.5, 0, 0.05, "displacement"),
}
"""``reference``: the published formulas. ``paper``: what reproduces the paper's figures."""


@dataclasses.dataclass(frozen=True)
class Smoothness:
    """Smoothness of one motion under one preset."""

    sparc: float
    ldlj: float
    samples: int
    preset: SmoothnessPreset


def smoothness(position: ArrayLike, fs: float, preset: str = "reference") -> Smoothness:
    """SPARC and LDLJ of a tip motion.

    Args:
        position: (N, 3) tip positions on a uniform grid [m].
        fs: its rate [Hz].
        preset: a name in ``PRESETS``.

    Raises:
        ValueError: unknown preset, a rate below the preset's, or a wrong shape.
    """
    try:
        chosen = PRESETS[preset]
    except KeyError:
        raise ValueError(f"no smoothness preset {preset!r}; there are {sorted(PRESETS)}") from None
    p = _rows3(position, "smoothness: position")
    if chosen.downsampling == "strided":
        slow = stride(p, fs, chosen.fs)
        speed = (
            np.linalg.norm(np.gradient(slow, 1.0 / chosen.fs, axis=0), axis=1)
            if len(slow) > 1
            else np.zeros(len(slow))
        )
        jerk_value = ldlj_displacement(slow, chosen.fs)
    else:
        velocity = downsample(differentiate(p, fs), fs, chosen.fs)
        speed = np.linalg.norm(velocity, axis=1)
        jerk_value = ldlj(velocity, chosen.fs)
    arc = sparc(
        speed,
        chosen.fs,
        fc=chosen.sparc_fc,
        padlevel=chosen.sparc_padlevel,
        amplitude_threshold=chosen.sparc_amplitude_threshold,
    )
    return Smoothness(arc, jerk_value, len(speed), chosen)


# --- filters and grids --------------------------------------------------------------------------


def uniform(t: ArrayLike, values: ArrayLike, fs: float) -> tuple[Array, Array]:
    """Bring samples to a uniform grid by linear interpolation.

    Args:
        t: (N,) increasing times [s].
        values: (N,) or (N, D).
        fs: rate of the grid [Hz]; it starts at t[0].

    Returns:
        The grid (M,) and the values on it.
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
    for the filter's padding (about half a period) are returned as they are.
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


def downsample(velocity: ArrayLike, fs: float, target_fs: float) -> Array:
    """Anti-aliased downsampling of a velocity vector, before any norm is taken.

    Zero-phase 8th-order Butterworth at 0.4 of the new rate, then linear interpolation on the new
    grid. Taking every n-th sample instead would fold tremor into the band and change LDLJ by 2.

    Raises:
        ValueError: when ``target_fs`` is above ``fs``.
    """
    if target_fs > fs * (1.0 + 1e-9):
        raise ValueError(f"downsample: {fs:g} Hz cannot be brought to {target_fs:g} Hz")
    v = np.asarray(velocity, dtype=float)
    if len(v) < 2:
        return v.copy()
    smooth = low_pass(v, fs, 0.4 * target_fs, order=8)
    return uniform(np.arange(len(v)) / fs, smooth, target_fs)[1]


def stride(values: ArrayLike, fs: float, target_fs: float) -> Array:
    """The samples nearest to a slower grid, with no filter: aliasing included."""
    v = np.asarray(values, dtype=float)
    if target_fs > fs * (1.0 + 1e-9):
        raise ValueError(f"stride: {fs:g} Hz cannot be brought to {target_fs:g} Hz")
    count = math.floor((len(v) - 1) * target_fs / fs + 1e-9) + 1 if len(v) else 0
    return np.asarray(v[np.rint(np.arange(count) * fs / target_fs).astype(int)])


# --- path, sweep, tracking ----------------------------------------------------------------------


def path_length(position: ArrayLike, fs: float | None = None, cutoff: float | None = None) -> float:
    """Length of a path [m].

    Args:
        position: (N, 3) [m].
        fs: rate of a uniform grid [Hz], needed with ``cutoff``.
        cutoff: low-pass (zero-phase Butterworth, order 4) before measuring [Hz], so that tremor,
            which adds length without going anywhere, does not count.
    """
    p = _rows3(position, "path_length: position")
    if cutoff is not None:
        if fs is None:
            raise ValueError("path_length: a cutoff needs fs")
        p = low_pass(p, fs, cutoff)
    return float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


def shaft_sweep(s_B: ArrayLike) -> float:
    """Largest angle between any two shaft directions of a run [rad].

    Exact: directions within a half-sphere are projected to the plane along great circles, where the
    two farthest lie on the convex hull.
    """
    s = _rows3(s_B, "shaft_sweep: s_B")
    s = s[np.all(np.isfinite(s), axis=1)]
    if len(s) < 2:
        return 0.0
    s = s / np.linalg.norm(s, axis=1, keepdims=True)
    candidates = _extreme_directions(s)
    best = 0.0
    for block in np.array_split(candidates, max(1, len(candidates) // 512)):
        chord = spatial.distance.cdist(block, candidates)
        best = max(best, float(np.max(chord)))
    return 2.0 * math.asin(min(1.0, best / 2.0))


def _extreme_directions(s: Array) -> Array:
    """Those unit vectors that can be the end of the largest angle."""
    mean = s.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return s
    mean /= np.linalg.norm(mean)
    cosine = s @ mean
    if np.min(cosine) < 0.05:  # not well inside one half-sphere
        return s
    u = np.cross(mean, np.eye(3)[np.argmin(np.abs(mean))])
    u /= np.linalg.norm(u)
    plane = np.stack([s @ u, s @ np.cross(mean, u)], axis=1) / cosine[:, None]
    try:
        return np.asarray(s[spatial.ConvexHull(plane).vertices])
    except spatial.QhullError:  # all on one line: the ends of that line
        _, _, rows = np.linalg.svd(plane - plane.mean(axis=0), full_matrices=False)
        along = plane @ rows[0]
        return np.asarray(s[[int(np.argmin(along)), int(np.argmax(along))]])


@dataclasses.dataclass(frozen=True)
class Tracking:
    """How well an executed path follows its input when the constant lag is taken out."""

    lag: float
    """Delay of the executed path [s]; at this shift the rms error is smallest."""
    rms: float
    """Root of the mean squared distance at that lag [m]."""
    max: float
    """Largest distance at that lag [m]."""
    error: Array
    """(N,) distance at that lag [m]; NaN where the shifted input has no sample."""


_NO_OVERLAP = 1e12
"""Mean square that stands for "cannot be compared": finite, because the search computes with it."""


def tracking(
    t: ArrayLike,
    executed: ArrayLike,
    t_input: ArrayLike,
    p_input: ArrayLike,
    max_lag: float = 0.6,
) -> Tracking:
    """Compare an executed path with its input after removing the lag.

    The lag is the shift, to a fraction of a sample, that makes the rms distance between
    executed(t) and input(t − lag) smallest; it is searched in [−max_lag/4, max_lag].

    Args:
        t: (N,) times of the executed samples [s].
        executed: (N, 3) [m].
        t_input: (M,) increasing times of the input samples [s].
        p_input: (M, 3) [m].
        max_lag: largest lag tried [s].

    Raises:
        ValueError: when a path has fewer than 2 samples or shapes do not fit.
    """
    times, path = np.asarray(t, dtype=float), _rows3(executed, "tracking: executed")
    source_t, source = np.asarray(t_input, dtype=float), _rows3(p_input, "tracking: p_input")
    if len(times) != len(path) or len(source_t) != len(source):
        raise ValueError("tracking: times and positions differ in length")
    if len(path) < 2 or len(source) < 2:
        raise ValueError("tracking: a path needs at least 2 samples")

    def distance(lag: float) -> Array:
        at = times - lag
        d = np.linalg.norm(path - interpolate(at, source_t, source), axis=1)
        d[(at < source_t[0] - 1e-9) | (at > source_t[-1] + 1e-9)] = np.nan
        return np.asarray(d)

    def mean_square(lag: float) -> float:
        d = distance(lag)
        covered = np.isfinite(d)
        # A lag that leaves less than half of the path covered explains nothing.
        return float(np.mean(d[covered] ** 2)) if covered.mean() >= 0.5 else _NO_OVERLAP

    grid = np.linspace(-max_lag / 4, max_lag, 76)
    values = [mean_square(lag) for lag in grid]
    if min(values) >= _NO_OVERLAP:
        raise ValueError("tracking: input and executed path do not overlap in time")
    best = int(np.argmin(values))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    result = optimize.minimize_scalar(
        mean_square, bounds=(low, high), method="bounded", options={"xatol": 1e-6}
    )
    lag = float(result.x) if result.fun <= values[best] else float(grid[best])
    if mean_square(0.0) <= mean_square(lag):
        lag = 0.0
    error = distance(lag)
    return Tracking(lag, float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(error)), error)


def percentiles(values: ArrayLike, *levels: float) -> list[float]:
    """Percentiles (0–100, linear interpolation) of the finite values; NaN when there is none."""
    v = np.asarray(values, dtype=float)
    v = v[np.isfinite(v)]
    if v.size == 0:
        return [math.nan] * len(levels)
    return [float(x) for x in np.percentile(v, levels)]


# --- checks -------------------------------------------------------------------------------------


def _rows3(value: ArrayLike, name: str) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} has shape {array.shape}, must be (N, 3)")
    return array


def _finite(value: ArrayLike, name: str) -> Array:
    array = np.asarray(value, dtype=float)
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is not finite at index {where}")
    return array


def _positive(value: float, name: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value}, must be > 0")
    return value
