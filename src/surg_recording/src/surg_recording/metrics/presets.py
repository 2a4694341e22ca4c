"""Smoothness of a tip motion, with every choice that its value depends on.

Values of different presets are never compared, and never shown in one figure.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from surg_recording.metrics._types import ArrayLike, finite, rows3
from surg_recording.metrics.filters import differentiate, downsample, stride
from surg_recording.metrics.jerk import ldlj, ldlj_displacement
from surg_recording.metrics.spectral import sparc


@dataclasses.dataclass(frozen=True)
class SmoothnessPreset:
    """Every choice that a smoothness value depends on."""

    name: str
    fs: float
    """Rate the motion is brought to [Hz]."""
    downsampling: str
    """``antialiased``: zero-phase low-pass of the velocity vector, whose norm is the speed;
    ``strided``: every n-th position, the speed by central differences."""
    antialias_hz: float | None
    """Cut-off of that low-pass [Hz]; None without one."""
    antialias_order: int | None
    sparc_fc: float
    sparc_padlevel: int
    sparc_amplitude_threshold: float
    ldlj_form: str
    """``velocity_vector`` is ``ldlj``, ``displacement`` is ``ldlj_displacement``."""

    def parameters(self) -> dict[str, str | float | int | None]:
        """All fields, for a label or a file."""
        return dataclasses.asdict(self)

    def label(self) -> str:
        """One line for a figure."""
        how = f"{self.fs:g} Hz {self.downsampling}"
        if self.antialias_hz is not None:
            how += f" (Butterworth {self.antialias_order}, {self.antialias_hz:g} Hz, zero phase)"
        return (
            f"preset {self.name}: {how},"
            f" SPARC fc {self.sparc_fc:g} Hz, padlevel {self.sparc_padlevel},"
            f" threshold {self.sparc_amplitude_threshold:g}, LDLJ {self.ldlj_form}"
        )


PRESETS: dict[str, SmoothnessPreset] = {
    preset.name: preset
    for preset in (
        SmoothnessPreset(
            name="reference",
            fs=5.0,
            downsampling="antialiased",
            antialias_hz=2.0,
            antialias_order=8,
            sparc_fc=2.5,
            sparc_padlevel=4,
            sparc_amplitude_threshold=0.05,
            ldlj_form="velocity_vector",
        ),
        SmoothnessPreset(
            name="paper",
            fs=5.0,
            downsampling="strided",
            antialias_hz=None,
            antialias_order=None,
            sparc_fc=2.5,
            sparc_padlevel=0,
            sparc_amplitude_threshold=0.05,
            ldlj_form="displacement",
        ),
    )
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
    """SPARC and LDLJ of tip positions (N, 3) on a uniform grid [m] of rate fs [Hz].

    Raises:
        ValueError: Unknown preset, a rate below the preset's, a wrong shape, or a non-finite value.
    """
    try:
        chosen = PRESETS[preset]
    except KeyError:
        raise ValueError(f"no smoothness preset {preset!r}; there are {sorted(PRESETS)}") from None
    p = finite(rows3(position, "smoothness: position"), "smoothness: position")
    if chosen.downsampling == "strided":
        slow = stride(p, fs, chosen.fs)
        speed = (
            np.linalg.norm(np.gradient(slow, 1.0 / chosen.fs, axis=0), axis=1)
            if len(slow) > 1
            else np.zeros(len(slow))
        )
        jerk_value = ldlj_displacement(slow, chosen.fs)
    else:
        velocity = downsample(
            differentiate(p, fs),
            fs,
            chosen.fs,
            cutoff=chosen.antialias_hz,
            order=chosen.antialias_order or 8,
        )
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
