"""What is wrong with the rows of one episode: times, missing values, jumps, standstill, actions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.quality.set_rows import Array, EpisodeRows, Finding, spans

OFF_RATE = 0.01
"""Share by which the mean rate may differ from the stated one."""
HOLE = 1.5
"""Periods between two rows, from which on some are missing."""
FROZEN_S = 0.5
"""[s] for which a state may repeat to the bit while the action moves."""
JUMP_SHARE = 0.2
"""Step from row to row, of what the column covers in the set."""
JUMP_TIMES = 4.0
"""The same, in multiples of the 97th percentile of the column's steps."""
STANDS = 1e-3
"""Usual step, of what the column covers, below which it is a switch, which may jump."""
BEYOND = 0.5
"""By how much an action may leave what its state covers in the set, of that."""
MOVES = 0.02
"""Change of an action in a span, of what it covers in the set, that a state must follow."""

Ranges = Mapping[str, tuple[Array, Array]]
"""Feature → lowest and highest value of each column in the set."""


def findings(rows: EpisodeRows, fps: float, ranges: Ranges) -> Iterator[Finding]:
    """All of one episode's rows."""
    yield from _times(rows, fps)
    for feature, values in rows.columns.items():
        yield from _missing(rows, feature, values)
    if STATE_KEY in rows.columns:
        yield from _jumps(rows, ranges)
        yield from _frozen(rows, fps, ranges)
        yield from _beyond(rows, ranges)
    if not any(text.strip() and text != "not stated" for text in rows.texts):
        yield Finding(rows.number, "no instruction", "task", "no row says what was to be done")


def _times(rows: EpisodeRows, fps: float) -> Iterator[Finding]:
    steps, period = np.diff(rows.times), 1.0 / fps
    if not len(steps):
        yield Finding(rows.number, "too short", "timestamp", f"{len(rows.times)} rows")
        return
    if (steps <= 0).any():
        at = int(np.argmin(steps))
        what = f"{int((steps <= 0).sum())} times, first by {steps[at]:.4f} s at row {at + 1}"
        yield Finding(rows.number, "time goes back or stands", "timestamp", what)
        return
    for at in np.flatnonzero(steps > HOLE * period)[:3]:
        what = f"{steps[at]:.3f} s between rows {at} and {at + 1}, a period is {period:.3f} s"
        yield Finding(rows.number, "a hole", "timestamp", what)
    rate = 1.0 / float(np.median(steps))
    if abs(rate / fps - 1.0) > OFF_RATE:
        what = f"{rate:.4g} rows a second, the set states {fps:.4g}"
        yield Finding(rows.number, "another rate", "timestamp", what)
    if (rows.frames != np.arange(len(rows.frames))).any():
        at = int(np.argmax(rows.frames != np.arange(len(rows.frames))))
        yield Finding(rows.number, "rows are missing", "frame_index", f"row {at} is not {at}")


def _missing(rows: EpisodeRows, feature: str, values: Array) -> Iterator[Finding]:
    broken = ~np.isfinite(values)
    if broken.any():
        at = int(np.argmax(broken.any(axis=1)))
        name = rows.named(feature, int(np.argmax(broken[at])))
        what = f"{int(broken.any(axis=1).sum())} rows, first row {at}"
        yield Finding(rows.number, "not a number", name, what)


def _jumps(rows: EpisodeRows, ranges: Ranges) -> Iterator[Finding]:
    """One step far beyond the others; an angle that wraps is none."""
    values, (low, high) = rows.columns[STATE_KEY], ranges[STATE_KEY]
    for column, covered in enumerate(high - low):
        series = values[:, column]
        steps = np.nan_to_num(np.abs(np.diff(series)))  # a missing value is said elsewhere
        if not len(steps) or np.median(steps) < STANDS * covered:
            continue
        usual = float(np.quantile(steps, 0.97, method="lower"))
        turned = np.abs(steps - 2 * np.pi) < 0.1 * np.pi
        far = (steps > JUMP_SHARE * covered) & (steps > JUMP_TIMES * usual) & ~turned
        if far.any():
            at = int(np.argmax(steps * far))
            what = f"by {steps[at]:.4g} at row {at + 1}, the set covers {covered:.4g}"
            yield Finding(rows.number, "a jump", rows.named(STATE_KEY, column), what)


def _frozen(rows: EpisodeRows, fps: float, ranges: Ranges) -> Iterator[Finding]:
    values, action = rows.columns[STATE_KEY], rows.columns.get(ACTION_KEY)
    if action is None or len(action) < 2:
        return
    same = (np.diff(values, axis=0) == 0).all(axis=1)
    low, high = ranges[ACTION_KEY]
    for begin, end in spans(same):
        moved = np.abs(np.diff(action[begin : end + 1], axis=0)).sum(axis=0)
        if (end - begin) / fps > FROZEN_S and (moved > MOVES * np.maximum(high - low, 1e-12)).any():
            what = f"rows {begin} to {end} repeat for {(end - begin) / fps:.2f} s, the action moves"
            yield Finding(rows.number, "the state is frozen", STATE_KEY, what)


def _beyond(rows: EpisodeRows, ranges: Ranges) -> Iterator[Finding]:
    """Actions named as their states are, far outside what the states cover."""
    action, names = rows.columns.get(ACTION_KEY), rows.names.get(ACTION_KEY) or ()
    states = list(rows.names.get(STATE_KEY) or ())
    if action is None:
        return
    low, high = ranges[STATE_KEY]
    for column, name in enumerate(names):
        if name not in states:
            continue
        k = states.index(name)
        room = BEYOND * (high[k] - low[k])
        out = (action[:, column] > high[k] + room) | (action[:, column] < low[k] - room)
        if room > 0 and out.any():
            at = int(np.argmax(out))
            what = f"{action[at, column]:.4g} at row {at}, states are {low[k]:.4g} to {high[k]:.4g}"
            yield Finding(
                rows.number, "an action beyond reach", rows.named(ACTION_KEY, column), what
            )
