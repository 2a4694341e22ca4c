"""How much a picture changes from frame to frame, independent of the light.

Each frame is scaled down, its logarithm taken and the local mean subtracted: a change of light,
also an uneven one, adds a constant that drops out. The difference of two such pictures is averaged
over cells. Each cell's usual activity (the median over time) is subtracted, so that a background in
motion, such as tissue that breathes, counts little beside a passing instrument.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

Array = npt.NDArray[np.float64]

WIDTH, HEIGHT = 96, 72
"""Size of the scaled-down frames [pixels]."""
CELL = 6
"""Side of a cell [pixels]."""
RADIUS = 8
"""Radius of the box of the local mean [pixels]."""


@dataclasses.dataclass(frozen=True)
class ImageMotion:
    """Change between consecutive frames of a video of N + 1 frames."""

    energy: Array
    """(N,) change from frame k to frame k + 1; no unit, 0: none."""
    usable: npt.NDArray[np.bool_]
    """(N,) False where the codec caused the change: frame k + 1 is a key frame."""

    def between(self, first: int, end: int) -> ImageMotion:
        """The motion from frame ``first`` to the frame before ``end``."""
        return ImageMotion(self.energy[first : end - 1], self.usable[first : end - 1])


def of_frames(frames: Iterable[tuple[npt.NDArray[np.uint8], bool]]) -> ImageMotion:
    """Motion of small grey pictures (HEIGHT, WIDTH) uint8, each with whether it is a key frame."""
    cells: list[Array] = []
    usable: list[bool] = []
    before: Array | None = None
    for picture, coded_anew in frames:
        now = _without_light(picture)
        if before is not None:
            cells.append(_by_cell(np.abs(now - before)))
            usable.append(not coded_anew)
        before = now
    if not cells:
        return ImageMotion(np.zeros(0), np.zeros(0, dtype=bool))
    change = np.stack(cells)
    lively = np.maximum(change - np.median(change, axis=0), 0.0)
    return ImageMotion(lively.mean(axis=1), np.array(usable))


def of_video(path: Path, progress: Callable[[int], None] | None = None) -> ImageMotion:
    """Motion of a video file as far as it is readable; an EpisodeError if it is not at all."""
    return of_frames(_small_frames(path, progress))


def _small_frames(
    path: Path, progress: Callable[[int], None] | None
) -> Iterable[tuple[npt.NDArray[np.uint8], bool]]:
    count = 0
    try:
        for count, frame in enumerate(video_file.frames(path), start=1):
            small = frame.reformat(width=WIDTH, height=HEIGHT, format="gray", interpolation="AREA")
            yield small.to_ndarray(), bool(frame.key_frame)
            if progress is not None and count % 100 == 0:
                progress(count)
    except EpisodeError:
        if not count:
            raise


def _without_light(picture: npt.NDArray[np.uint8]) -> Array:
    """Logarithm of the picture minus its local mean; + 8 keeps the noise of dark places small."""
    logarithm = np.log(picture.astype(np.float64) + 8.0)
    return logarithm - ndimage.uniform_filter(logarithm, 2 * RADIUS + 1, mode="nearest")


def _by_cell(change: Array) -> Array:
    """Means over cells, (cells,)."""
    rows, columns = HEIGHT // CELL, WIDTH // CELL
    return change.reshape(rows, CELL, columns, CELL).mean(axis=(1, 3)).ravel()
