"""An episode of a data set in arrays, and one finding about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WHOLE = -1
"""The number of a finding about the whole set."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        episode: Its number, or `WHOLE`.
        kind: Such as ``a jump``.
        where: The column, the camera or the file.
        what: In words, with figures.
    """

    episode: int
    kind: str
    where: str
    what: str


@dataclasses.dataclass(frozen=True)
class EpisodeRows:
    """The numbers of one episode.

    Attributes:
        number: Its number.
        times: (T,) stated times since its beginning [s].
        frames: (T,) stated ``frame_index``.
        columns: Feature → (T, D); NaN where a value is missing.
        names: Feature → its D names; none where they are not stated.
        texts: (T,) what was to be done.
    """

    number: int
    times: Array
    frames: npt.NDArray[np.int64]
    columns: Mapping[str, Array]
    names: Mapping[str, Sequence[str]]
    texts: Sequence[str]

    def named(self, feature: str, column: int) -> str:
        """A column for people."""
        names = self.names.get(feature) or ()
        return f"{feature} {names[column] if column < len(names) else column}"


@dataclasses.dataclass(frozen=True)
class EpisodePictures:
    """The pictures of one camera in one episode, small and grey.

    Attributes:
        camera: The feature.
        rows: (N,) the row of each picture, increasing.
        small: (N, HEIGHT, WIDTH) uint8 of `image_motion`.
    """

    camera: str
    rows: npt.NDArray[np.int64]
    small: npt.NDArray[np.uint8]


def spans(bad: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and behind the last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
