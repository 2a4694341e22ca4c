"""Does a grabbed picture show a live endoscope?

A grabber without a signal goes on with pictures: black, blue, colour bars, or the last one again.
None of them may pass for the patient. Thresholds are in grey levels of 255.
"""

from __future__ import annotations

import enum
import zlib

import numpy as np

from surg_perception.capture.picture_source import Image

DARK = 24
"""A picture without any brighter pixel is black; sensors read out noise of 1 to 5, and studio
black is 16."""
EVEN = 6
"""Largest range of a uniform area."""
FROZEN_NS = 1_000_000_000
"""The noise of a sensor changes every picture; one that stays the same for so long is frozen."""
GRID = 8
"""Only every 8th row and column is looked at, but for interlacing."""
STRIPED = 0.6
"""Share of the picture that colour bars fill at least."""
BARS = (5, 9)
"""Number of colour bars side by side."""
LEAST_HALF = 0.25
"""Share of the rows that a missing part has at least."""
TEXTURED = 0.6
"""Share of the last good row that must differ from the fill: the round edge of an endoscope's
picture differs in few pixels where its dark begins."""
COMBED = 1.6
"""Contrast of neighbouring rows over that of rows two apart; 0.6 in natural pictures."""
LEAST_CONTRAST = 4.0
INTERLACED_OF = (8, 30)
"""So many of the last pictures must be combed: fields differ only where something moves."""


class Signal(enum.StrEnum):
    """What a picture shows."""

    LIVE = ""
    BLACK = "black"
    BLUE = "blue"
    BARS = "colour_bars"
    FROZEN = "frozen"
    HALF = "half_picture"
    INTERLACED = "interlaced"
    WRONG_SIZE = "wrong_size"


CURES = {
    Signal.BLACK: "the picture is black: switch on camera and light source, check the cable",
    Signal.BLUE: "the grabber shows its blue screen: it has no signal; check cable and camera",
    Signal.BARS: "the source sends colour bars: switch its test pattern off, connect the camera",
    Signal.FROZEN: "the picture is frozen: check for a freeze function at the camera controller, "
    "then the cable",
    Signal.HALF: "part of the picture is missing: the grabber loses data; use another USB port or "
    "a shorter cable",
    Signal.INTERLACED: "the signal is interlaced: set the camera controller's output to a "
    "progressive mode (p instead of i)",
    Signal.WRONG_SIZE: "the picture has another size than endoscope.size in cell.yaml",
}


class SignalWatch:
    """Judges one device's pictures, in their order.

    Args:
        size: Width and height that are wanted [px]; 0: any.
        still: Whether the same picture may come again and again, as from a file.
        rows: Whether the eyes are in alternate rows, which looks like interlacing.
    """

    def __init__(
        self, size: tuple[int, int] = (0, 0), still: bool = False, rows: bool = False
    ) -> None:
        self._size, self._still, self._rows = size, still, rows
        self._same = (-1, 0)  # checksum, stamp of the first picture with it
        self._combed: list[bool] = []

    def judge(self, picture: Image, stamp_ns: int) -> Signal:
        """What a picture (h, w, 3) with this stamp shows."""
        height, width = picture.shape[:2]
        if self._size != (0, 0) and (width, height) != self._size:
            return Signal.WRONG_SIZE
        sparse = picture[::GRID, ::GRID]
        frozen = self._frozen(sparse, stamp_ns)
        return (
            _uniform(sparse)
            or (Signal.BARS if _bars(sparse) else Signal.LIVE)
            or (Signal.HALF if _half(sparse) else Signal.LIVE)
            or (Signal.INTERLACED if self._interlaced(picture) else Signal.LIVE)
            or (Signal.FROZEN if frozen else Signal.LIVE)
        )

    def _frozen(self, sparse: Image, stamp_ns: int) -> bool:
        if self._still:
            return False
        same = zlib.crc32(np.ascontiguousarray(sparse).data)
        if same != self._same[0] or stamp_ns < self._same[1]:
            self._same = same, stamp_ns
        return stamp_ns - self._same[1] >= FROZEN_NS

    def _interlaced(self, picture: Image) -> bool:
        if self._rows:
            return False
        self._combed = [*self._combed[1 - INTERLACED_OF[1] :], combed(picture)]
        return sum(self._combed) >= INTERLACED_OF[0]


def _uniform(sparse: Image) -> Signal:
    if int(sparse.max()) <= DARK:
        return Signal.BLACK
    low, high = sparse.min((0, 1)).astype(int), sparse.max((0, 1)).astype(int)
    blue = high[2] > 100 and max(high[0], high[1]) < low[2] // 2
    return Signal.BLUE if blue and (high - low).max() <= EVEN else Signal.LIVE


def _bars(sparse: Image) -> bool:
    """Whether most of the picture is vertical stripes of one colour each, most of them saturated.

    A text or a grey scale may stand in them.
    """
    row = np.median(sparse, 0)
    if (np.abs(sparse - row).max(2) <= EVEN).mean() < STRIPED:
        return False
    edges = np.abs(np.diff(row, axis=0)).max(1) > 40
    starts = np.flatnonzero(edges[1:] & ~edges[:-1]).size + int(edges[0])
    saturated = np.mean(row.max(1) - row.min(1) > 80)
    return BARS[0] <= starts + 1 <= BARS[1] and bool(saturated > 0.5)


def _half(sparse: Image) -> bool:
    """Whether the lower rows are one colour below a row that is a picture."""
    fill = sparse[-1, 0].astype(int)
    differs = np.abs(sparse.astype(int) - fill).max(2) > EVEN
    good = np.flatnonzero(differs.any(1))
    if not good.size or good[-1] + 1 > (1 - LEAST_HALF) * len(sparse):
        return False
    return bool(differs[good[-1]].mean() > TEXTURED)


def combed(picture: Image) -> bool:
    """Whether neighbouring rows differ more than rows that are two apart."""
    columns = picture[:, ::16, 1].astype(np.int16)
    if len(columns) < 8:
        return False
    near = np.abs(np.diff(columns, axis=0))[:-1].astype(float)
    far = np.abs(columns[2:] - columns[:-2]).astype(float)
    moving = near > 12  # fields differ only where something moves
    if moving.mean() < 0.01:
        return False
    return bool(near[moving].mean() > COMBED * max(far[moving].mean(), LEAST_CONTRAST))
