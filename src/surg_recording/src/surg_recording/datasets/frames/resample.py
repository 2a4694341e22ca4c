"""Resamples recorded series to a strict grid: previous sample, linear, slerp, zero-order hold.

Stamps are int64 nanoseconds of one clock and increase strictly. Nothing is extrapolated: a grid
time before the first sample, or too far from one, is an error that states the time. Every function
also returns the index of the sample used, from which true stamps and ages are taken.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from surg_core import transforms
from surg_core.contract import SECOND_NS
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Grid:
    """Frame k of ``frames`` stands at ``start_ns`` + k / ``fps``."""

    start_ns: int
    fps: int
    frames: int

    @property
    def times_ns(self) -> Stamps:
        """(frames,) grid times in the recording's clock, rounded to a nanosecond each."""
        return self.start_ns + offsets_ns(np.arange(self.frames), self.fps)

    @property
    def next_ns(self) -> Stamps:
        """(frames,) the grid time after each frame."""
        return self.start_ns + offsets_ns(np.arange(1, self.frames + 1), self.fps)

    @property
    def timestamps(self) -> Array:
        """(frames,) k / fps [s], exactly: never summed up."""
        return np.arange(self.frames) / self.fps


def offsets_ns(k: npt.NDArray[np.int64], fps: int) -> Stamps:
    """K / fps in whole nanoseconds, rounded half up, without passing through floats."""
    return (2 * k.astype(np.int64) * SECOND_NS + fps) // (2 * fps)


def previous(stamps: Stamps, times: Stamps, what: str, max_age_ns: int | None = None) -> Stamps:
    """Index (K,) of the newest sample that is not later than each time.

    Args:
        stamps: (N,) of the samples, strictly increasing [ns].
        times: (K,) requested times [ns].
        what: The series, for messages.
        max_age_ns: Largest age of a sample; None: it holds forever.

    Raises:
        EpisodeError: There is no sample yet, or it is too old.
    """
    index = np.searchsorted(stamps, times, side="right") - 1
    early = np.flatnonzero(index < 0)
    if len(early):
        later = f"{(stamps[0] - times[early[0]]) / 1e6:.1f} ms later" if len(stamps) else "missing"
        raise EpisodeError(
            f"{what}: no sample at or before {_at(times, early[0])}; the first is {later}"
        )
    if max_age_ns is not None:
        age = times - stamps[index]
        old = np.flatnonzero(age > max_age_ns)
        if len(old):
            raise EpisodeError(
                f"{what}: the newest sample at {_at(times, old[0])} is"
                f" {age[old[0]] / 1e6:.1f} ms old, at most {max_age_ns / 1e6:g} ms are allowed"
                f" ({len(old)} of {len(times)} frames; it stalled or frames were dropped);"
                " --allow old-pictures exports it anyway"
            )
    return index.astype(np.int64)


def around(stamps: Stamps, times: Stamps) -> Stamps:
    """Rows (M,), increasing, that the functions of this module need to resample at ``times``.

    With these rows only, they give the same values and errors as with all N samples. The first and
    the last row are among them.
    """
    last = len(stamps) - 1
    before = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, last)
    return np.unique(np.concatenate([[0, last], before, np.minimum(before + 1, last)]))


def _brackets(
    stamps: Stamps, times: Stamps, what: str, max_gap_ns: int
) -> tuple[Stamps, Stamps, Array]:
    """Samples before and after each time, and its position between them in [0, 1]."""
    before = previous(stamps, times, what)
    after = np.where(stamps[before] == times, before, before + 1)
    late = np.flatnonzero(after >= len(stamps))
    if len(late):
        raise EpisodeError(
            f"{what}: ends {(times[late[0]] - stamps[-1]) / 1e6:.1f} ms before"
            f" {_at(times, late[0])}"
        )
    gap = stamps[after] - stamps[before]
    wide = np.flatnonzero(gap > max_gap_ns)
    if len(wide):
        raise EpisodeError(
            f"{what}: no sample for {gap[wide[0]] / 1e6:.1f} ms round {_at(times, wide[0])},"
            f" at most {max_gap_ns / 1e6:g} ms are bridged ({len(wide)} of {len(times)} frames);"
            " --fps takes a rate that the recording has"
        )
    part = (times - stamps[before]) / np.maximum(gap, 1)
    return before, after, part


def linear(
    stamps: Stamps, values: Array, times: Stamps, what: str, max_gap_ns: int
) -> tuple[Array, Stamps]:
    """Linear interpolation between the samples before and after.

    Args:
        stamps: (N,) [ns].
        values: (N, D).
        times: (K,) [ns].
        what: The series, for messages.
        max_gap_ns: Samples further apart are not bridged.

    Returns:
        (K, D) values, exactly the sample's where a time meets one, and (K,) the index of the
        sample before.

    Raises:
        EpisodeError: A time outside the samples, or in a gap.
    """
    before, after, part = _brackets(stamps, times, what, max_gap_ns)
    a, b, part = values[before], values[after], part[:, None]
    return np.where(part == 0.0, a, a + (b - a) * part), before


def slerp(
    stamps: Stamps, quaternions: Array, times: Stamps, what: str, max_gap_ns: int
) -> tuple[Array, Stamps]:
    """Spherical linear interpolation of unit quaternions x, y, z, w, along the shorter arc.

    Successive results are in one hemisphere (no sign flips), so that the series is continuous; the
    first has w ≥ 0. Arguments, results and errors as for ``linear``; quaternions (N, 4) of any sign
    are normalised here, and one without length is an error.
    """
    before, after, part = _brackets(stamps, times, what, max_gap_ns)
    length = np.linalg.norm(quaternions, axis=1)
    if not np.all(length > 0.5):
        line = int(np.flatnonzero(~(length > 0.5))[0]) + 2
        raise EpisodeError(f"{what}, line {line}: this quaternion is none (its length is no 1)")
    unit = quaternions / length[:, None]
    interpolated = transforms.slerp(unit[before], unit[after], part)
    return transforms.continuous_quaternions(interpolated), before


def _at(times: Stamps, row: int) -> str:
    """A grid time for a message: seconds from the first."""
    return f"frame {int(row)} ({(times[row] - times[0]) * 1e-9:.3f} s)"
