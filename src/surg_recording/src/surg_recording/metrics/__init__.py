"""Metrics of the paper and related ones: functions from arrays to values, SI units.

Smoothness has many variants; a ``SmoothnessPreset`` names one. Values of different presets are
never compared. Formulas, parameters and limits: docs/guide/evaluation.md.
"""

from surg_recording.metrics.filters import (
    differentiate,
    downsample,
    interpolate,
    low_pass,
    percentiles,
    stride,
    uniform,
)
from surg_recording.metrics.jerk import ldlj, ldlj_displacement
from surg_recording.metrics.lag import Tracking, tracking
from surg_recording.metrics.path import Idle, idle, path_length, shaft_sweep
from surg_recording.metrics.pivot import rcm_deviation
from surg_recording.metrics.presets import PRESETS, Smoothness, SmoothnessPreset, smoothness
from surg_recording.metrics.spectral import sparc

__all__ = [
    "PRESETS",
    "Idle",
    "Smoothness",
    "SmoothnessPreset",
    "Tracking",
    "differentiate",
    "downsample",
    "idle",
    "interpolate",
    "ldlj",
    "ldlj_displacement",
    "low_pass",
    "path_length",
    "percentiles",
    "rcm_deviation",
    "shaft_sweep",
    "smoothness",
    "sparc",
    "stride",
    "tracking",
    "uniform",
]
