"""What is wrong with the pictures of one camera in one episode: missing, black, frozen, late."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from surg_core.contract import STATE_KEY
from surg_recording.clock.verdict import FAIL
from surg_recording.quality.set_rows import Array, EpisodePictures, EpisodeRows, Finding, spans
from surg_recording.video import image_motion, video_lag

BLACK_MEAN, BLACK_SPREAD = 24.0, 4.0
"""Of 255: below both, nothing is seen; video's own black is 16."""
BLACK_S = 0.1
"""[s] of black from which on it is said."""
FROZEN_S = 0.5
"""[s] of motion that a picture may not show."""
SAME = 0.35
"""Mean difference of small grey pictures, of 255, that a codec leaves between equal ones."""
MOST_STATES = 16
"""Of which each is tried as what the picture shows."""
LAG_NEEDS_S = 8.0
"""[s] An episode of less shows too little motion to tell a lag."""
FULL_SPEED = 2e-3
"""[m] per row that the fastest motion counts as for the lag, which needs only its course."""


def findings(rows: EpisodeRows, seen: EpisodePictures, fps: float) -> Iterator[Finding]:
    """All of one camera."""
    missing = len(rows.times) - len(seen.rows)
    if missing:
        what = f"{missing} of {len(rows.times)} rows have none"
        yield Finding(rows.number, "pictures are missing", seen.camera, what)
    if len(seen.rows) < 2:
        return
    means, spread = seen.small.mean(axis=(1, 2)), seen.small.std(axis=(1, 2))
    for begin, end in spans((means < BLACK_MEAN) & (spread < BLACK_SPREAD)):
        if (end - begin) / fps >= BLACK_S:
            what = f"rows {seen.rows[begin]} to {seen.rows[end - 1]}"
            yield Finding(rows.number, "black pictures", seen.camera, what)
    speeds = _speeds(rows)
    yield from _frozen(rows.number, seen, speeds.max(axis=1, initial=0.0)[seen.rows[:-1]], fps)
    yield from _late(rows, seen, speeds)


def _speeds(rows: EpisodeRows) -> Array:
    """(T, D) how much each state changes from a row to the next; 1 is its fastest."""
    values = np.nan_to_num(rows.columns.get(STATE_KEY, np.zeros((len(rows.times), 0))))
    steps = np.abs(np.diff(values, axis=0, append=values[-1:]))
    largest = steps.max(axis=0, initial=0.0)
    return np.asarray(steps[:, largest > 0] / largest[largest > 0])


def _frozen(number: int, seen: EpisodePictures, speed: Array, fps: float) -> Iterator[Finding]:
    difference = np.abs(np.diff(seen.small.astype(np.int16), axis=0)).mean(axis=(1, 2))
    moving = speed > 0.1
    if np.median(difference[moving], axis=0) < SAME if moving.any() else True:
        return  # the robot is not in view, or hardly
    for begin, end in spans(difference < SAME):
        if moving[begin:end].sum() / fps > FROZEN_S:
            what = f"rows {seen.rows[begin]} to {seen.rows[end]} show the same, the robot moves"
            yield Finding(number, "pictures are frozen", seen.camera, what)


def _late(rows: EpisodeRows, seen: EpisodePictures, speeds: Array) -> Iterator[Finding]:
    """The way of each state, as if it were a tip's, against the change of the picture."""
    if rows.times[-1] - rows.times[0] < LAG_NEEDS_S:
        return
    motion = image_motion.of_frames((small, False) for small in seen.small)
    ways = FULL_SPEED * np.cumsum(np.vstack([0.0 * speeds[:1], speeds[:-1]]), axis=0)
    paths = {
        str(k): video_lag.TipPath(rows.times, np.column_stack([way, 0 * way, 0 * way]))
        for k, way in enumerate(ways.T[:MOST_STATES])
    }
    found = video_lag.estimate(rows.times[seen.rows], motion, paths)
    if found.verdict == FAIL and found.lag is not None:
        word = "late" if found.lag > 0 else "early"
        what = f"{abs(found.lag):.3f} s {word} against {STATE_KEY}"
        yield Finding(rows.number, "pictures and state do not fit", seen.camera, what)
