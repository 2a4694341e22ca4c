"""The time of each row of a LeRobot data set, which it states up to three times."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import SECOND_NS
from surg_recording.imports.ledger import Ledger
from surg_recording.recording_errors import EpisodeError

Stamps = npt.NDArray[np.int64]

GRID = "timing.grid_ns"
"""Column of ``./surg episode export``: stamps of the recording [ns]."""
START_NS = SECOND_NS
"""Stamp of the frame 0 where the data set states none [ns]."""
EXACT_S = 1e-3
"""A timestamp that differs by less from its frame's is rounded: it is stored in 32 bits."""


def row_times(table: Any, fps: Fraction, where: str, ledger: Ledger) -> Stamps:
    """Stamps of the rows [ns], strictly increasing.

    Args:
        table: The rows, in the order of ``frame_index``.
        fps: Rate of the data set [1/s].
        where: The episode, for messages.
        ledger: Receives which frames are missing.

    Raises:
        EpisodeError: Two statements differ by more than half a frame, or one is missing.
    """
    index = _column(table, "frame_index", where)
    if (np.diff(index) <= 0).any():
        twice = int(index[np.argmax(np.diff(index) <= 0)])
        raise EpisodeError(f"{where}: frame_index {twice} is there twice; each is needed once")
    missing = int(index[-1] - index[0] + 1 - len(index))
    if missing:
        after = int(index[np.argmax(np.diff(index) > 1)])
        ledger.assume(f"{where}: {missing} frames are missing, the first behind frame {after}")
    expected = np.array([round(int(k) * SECOND_NS / fps) for k in index], np.int64)
    stamps = START_NS + expected
    if "timestamp" in table.column_names:
        stated = _column(table, "timestamp", where)
        _refuse_differences(stated * SECOND_NS, expected, fps, where, "timestamp")
        if (np.abs(stated - expected / SECOND_NS) > EXACT_S).any():
            stamps = START_NS + np.round(stated * SECOND_NS).astype(np.int64)
    else:
        ledger.assume(f"{where}: no column timestamp; frame_index / fps is the time")
    if GRID in table.column_names:
        stamps = np.array(table.column(GRID).to_pylist(), np.int64).reshape(-1)
        since = (stamps - stamps[0]).astype(float)
        _refuse_differences(since, expected - expected[0], fps, where, GRID)
    if (np.diff(stamps) <= 0).any():
        raise EpisodeError(f"{where}: the times of its rows do not increase")
    return stamps


def _column(table: Any, name: str, where: str) -> npt.NDArray[np.float64]:
    if name not in table.column_names:
        raise EpisodeError(f"{where}: no column {name}")
    values = np.array(table.column(name).to_pylist(), np.float64).reshape(-1)
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values)))
        raise EpisodeError(f"{where}, row {row}: {name} is empty or not a number")
    return values


def _refuse_differences(
    stated: npt.NDArray[np.float64], expected: Stamps, fps: Fraction, where: str, name: str
) -> None:
    wrong = np.abs(stated - expected) > 0.5 * SECOND_NS / float(fps)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise EpisodeError(
            f"{where}, row {row}: {name} says {stated[row] / SECOND_NS:.3f} s, frame_index at"
            f" {float(fps):g} Hz {expected[row] / SECOND_NS:.3f} s; allowed: half a frame apart."
            " Write the data set again with the one that is right"
        )
