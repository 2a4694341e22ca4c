"""A clock that a camera can read: the time as black and white cells in a black frame.

The pattern has ``COLUMNS`` by ``ROWS`` cells. The corner at the upper left is white and the other
three are black, so its turn is known. The other cells hold the time in milliseconds, modulo 2**24,
and a CRC-16 (polynomial 0x1021, begin 0xFFFF) of it, high bit first, row by row. A picture that was
exposed while the screen changed has a wrong CRC and is left out. `clock_pattern.html` draws it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

COLUMNS, ROWS = 8, 6
FRAME = 1
"""Width of the black frame, in cells."""
TIME_BITS, CRC_BITS = 24, 16
PERIOD_MS = 1 << TIME_BITS
LEAST_AREA = 0.005
"""Share of the picture that the frame covers at least."""
_CORNERS = ((0, 0), (0, COLUMNS - 1), (ROWS - 1, 0), (ROWS - 1, COLUMNS - 1))
_PLACES = [
    (row, column)
    for row in range(ROWS)
    for column in range(COLUMNS)
    if (row, column) not in _CORNERS
][: TIME_BITS + CRC_BITS]
_CELL_PX = 8


def crc16(time_ms: int) -> int:
    """CRC-16 of the three bytes of a time."""
    crc = 0xFFFF
    for byte in time_ms.to_bytes(3, "big"):
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def cells(time_ms: int) -> NDArray[np.bool_]:
    """The cells (rows, columns) of a time; True is white."""
    time_ms %= PERIOD_MS
    word = time_ms << CRC_BITS | crc16(time_ms)
    found = np.zeros((ROWS, COLUMNS), bool)
    found[0, 0] = True
    for bit, place in enumerate(reversed(_PLACES)):
        found[place] = word >> bit & 1
    return found


def drawn(time_ms: int, cell_px: int = 20, margin_px: int = 40) -> Image:
    """The pattern as a picture (h, w) on white."""
    framed = np.pad(cells(time_ms), FRAME)
    large = np.kron(framed, np.ones((cell_px, cell_px), bool))
    return np.asarray(255 * np.pad(large, margin_px, constant_values=True), np.uint8)


def read(picture: Image) -> int | None:
    """The time [ms, modulo 2**24] in a picture (h, w, 3) or (h, w); None: there is none."""
    grey: Any = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    for corners in _frames(grey):
        for turn in range(4):
            time_ms = _decoded(_flattened(grey, np.roll(corners, turn, axis=0)))
            if time_ms is not None:
                return time_ms
    return None


def age_ms(stamp_ns: int, time_ms: int) -> float:
    """Time from what a picture shows to its stamp [ms], within half a period."""
    half = PERIOD_MS / 2
    return (stamp_ns * 1e-6 - time_ms + half) % PERIOD_MS - half


def _frames(grey: Image) -> Iterator[NDArray[np.float32]]:
    """Corners (4, 2) of dark quadrangles, the largest first, in the order of the clock."""
    _, dark = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    for contour in sorted(contours, key=cv2.contourArea, reverse=True):
        if cv2.contourArea(contour) < LEAST_AREA * grey.size:
            return
        corners = cv2.approxPolyDP(contour, 0.04 * cv2.arcLength(contour, True), True)
        if len(corners) == 4 and cv2.isContourConvex(corners):
            ordered = corners[:, 0].astype(np.float32)
            around = cv2.contourArea(ordered, True)  # positive: clockwise as the picture is seen
            yield ordered if around > 0 else ordered[::-1]


def _flattened(grey: Image, corners: NDArray[np.float32]) -> NDArray[np.float64]:
    """Brightness of the cells (rows, columns) in a quadrangle that begins at the upper left."""
    width, height = (_CELL_PX * (count + 2 * FRAME) for count in (COLUMNS, ROWS))
    target = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    warp = cv2.getPerspectiveTransform(corners.astype(np.float32), target)
    flat = np.asarray(cv2.warpPerspective(grey, warp, (width, height)), float)
    blocks = flat.reshape(height // _CELL_PX, _CELL_PX, width // _CELL_PX, _CELL_PX)
    inner = blocks[FRAME:-FRAME, 2:-2, FRAME:-FRAME, 2:-2]
    return np.asarray(inner.mean((1, 3)))


def _decoded(brightness: NDArray[np.float64]) -> int | None:
    white = brightness > 0.5 * (brightness.min() + brightness.max())
    if [bool(white[corner]) for corner in _CORNERS] != [True, False, False, False]:
        return None
    word = 0
    for place in _PLACES:
        word = word << 1 | int(white[place])
    time_ms = word >> CRC_BITS
    return time_ms if word & 0xFFFF == crc16(time_ms) else None
