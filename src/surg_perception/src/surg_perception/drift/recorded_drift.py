"""The watch over a recorded episode."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator

import numpy as np

from surg_core.config import Cell
from surg_core.transforms import FloatArray
from surg_perception.depth.recorded_eyes import RecordedEyes, RecordedPair
from surg_perception.drift.drift_state import DriftState, state_of
from surg_perception.drift.drift_watch import DriftWatch, Joints
from surg_perception.drift.stated_parts import stated_parts
from surg_perception.stereo.joint_history import between
from surg_recording.episode.episode_reader import Episode

NS = 1e-9


def watched(
    cell: Cell, episode: Episode, progress: Callable[[float], None] = lambda share: None
) -> Iterator[tuple[DriftWatch, RecordedPair, DriftState]]:
    """The watch behind each pair of pictures that said something, with its state.

    Args:
        cell: As it is calibrated now.
        episode: Of a stereo endoscope.
        progress: Takes the share that is done.

    Raises:
        ConfigError: The cell is not calibrated.
        EpisodeError: Pictures or joints are missing or broken.
    """
    eyes = RecordedEyes(episode)
    watch = DriftWatch(cell, eyes.lenses, stated_parts(cell))
    for pair in show(cell, eyes, watch, progress=progress):
        yield watch, pair, state_of(watch.verdict, watch.unseen)


def show(
    cell: Cell,
    eyes: RecordedEyes,
    watch: DriftWatch,
    since: float = 0.0,
    progress: Callable[[float], None] = lambda share: None,
) -> Iterator[RecordedPair]:
    """Show a watch the pictures from a time on [s], of a recording that begins at 0.

    Yields:
        Those that said something.
    """
    begin = int(eyes.stamps[0])
    joints = recorded_joints(cell, eyes.episode, begin)
    for number, pair in enumerate(eyes.pairs()):
        progress(number / len(eyes.stamps))
        stamp, pictures = NS * (pair.stamp_ns - begin), (pair.left, pair.right)
        if stamp >= since and watch.look(stamp, pictures, joints):
            yield pair


def recorded_joints(cell: Cell, episode: Episode, begin: int) -> Joints:
    """Measured joints of every arm of a cell, by time since a stamp [ns].

    Raises:
        EpisodeError: An arm of the cell was not recorded.
    """
    tables: dict[str, tuple[list[int], FloatArray]] = {}
    for name, arm in cell.arms.items():
        columns = [f"q{i}" for i in range(len(arm.chain.joints))]
        table = episode.columns(f"cycle_{name}", columns)
        q = np.stack([table[column] for column in columns], axis=1)
        tables[name] = np.asarray(table["stamp_ns"]).tolist(), q

    def at(arm: str, stamp: float) -> FloatArray | None:
        stamps, q = tables[arm]
        stamp_ns = begin + round(stamp / NS)
        after = bisect_right(stamps, stamp_ns)
        if not 0 < after < len(stamps):
            return None
        before = after - 1
        return between((stamps[before], q[before]), (stamps[after], q[after]), stamp_ns)

    return at
