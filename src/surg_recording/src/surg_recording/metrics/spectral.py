"""Spectral arc length of a speed profile.

S. Balasubramanian, A. Melendez-Calderon, E. Burdet, "A robust and sensitive metric for quantifying
movement smoothness", IEEE TBME 59(8), 2012; in its present form S. Balasubramanian et al., "On the
analysis of movement smoothness", J. NeuroEng. Rehabil. 12:112, 2015.
"""

from __future__ import annotations

import math

import numpy as np

from surg_recording.metrics._types import ArrayLike, finite, positive


def sparc(
    speed: ArrayLike,
    fs: float,
    *,
    fc: float | None = None,
    amplitude_threshold: float = 0.05,
    padlevel: int = 4,
) -> float:
    """Spectral arc length of a speed profile: 0 at best, more negative when less smooth.

    The arc of the speed's amplitude spectrum, normalised by its peak, up to the cut-off or the last
    frequency whose amplitude reaches the threshold.

    Args:
        speed: (N,) in any unit.
        fs: Sampling rate [Hz].
        fc: Cut-off [Hz]; default min(10, fs/2). Limited to fs/2, because beyond it the spectrum is
            only a mirror image that would be counted twice.
        amplitude_threshold: Of the normalised spectrum.
        padlevel: Zero padding to 2^(ceil(log2 N) + padlevel) samples.

    Returns:
        The arc length (≤ 0); NaN without motion or with fewer than 2 samples.

    Raises:
        ValueError: A wrong shape, a non-finite value, or fs, fc or padlevel out of range.
    """
    v = finite(speed, "sparc: speed")
    if v.ndim != 1:
        raise ValueError(f"sparc: speed has shape {v.shape}, must be (N,)")
    positive(fs, "sparc: fs")
    if padlevel < 0:
        raise ValueError(f"sparc: padlevel is {padlevel}, must be ≥ 0")
    cutoff = min(10.0 if fc is None else positive(fc, "sparc: fc"), fs / 2)
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
