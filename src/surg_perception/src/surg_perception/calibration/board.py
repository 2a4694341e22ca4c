"""The calibration board: a ChArUco pattern, how it is drawn and how its corners are found.

**Board frame.** Origin in the lower left corner of the pattern, x right, y up, z out of the board
towards who looks at it. The pattern has a black square in the upper left corner; its markers are
numbered row by row from there. Corners have OpenCV's numbers: row by row from the upper left.

OpenCV 4.6 names its functions otherwise than later versions, and its board has y down. Only this
module calls them. All versions count a refined corner's pixels from the picture's edge, half a
pixel more than everything else, which counts from the first pixel's centre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from surg_core.transforms import FloatArray

Picture = NDArray[np.uint8]

EDGE_TO_CENTRE = 0.5
"""[px] From pixels counted from the picture's edge to pixels counted from a pixel's centre."""
WINDOW_SHARE = 0.1
"""Half the window in which a corner is refined, as a share of a square's side in the picture.

A larger window reaches the markers, a smaller one sees more noise.
"""
LARGEST_BEND = 0.5
"""Largest distance of corners from a flat board in perspective, rms, in sides of a square."""
LEAST_CORNERS = 8
"""Corners of the board that a picture must show to count."""
MARKER_SHARE = 0.7
"""Side of a marker over side of a square."""
DICTIONARIES = ("DICT_4X4_100", "DICT_5X5_100", "DICT_6X6_100", "DICT_4X4_250", "DICT_5X5_250")
LARGEST_STRETCH = 0.05
"""Largest share by which a printed ruler may be longer or shorter than 100 mm."""


class BoardError(ValueError):
    """A board, or a picture of it, must not be used; the message states why and what to do."""


@dataclass(frozen=True)
class Corners:
    """Corners of the board in one picture.

    Attributes:
        ids: ``(n,)`` their numbers.
        pixels: ``(n, 2)`` x right, y down; the centre of the first pixel is 0, 0 [px].
    """

    ids: NDArray[np.int64]
    pixels: FloatArray

    def only(self, ids: NDArray[np.int64]) -> Corners:
        """Those with the numbers ``ids``, which must all be there, in the order of ``ids``."""
        where = {int(number): row for row, number in enumerate(self.ids)}
        return Corners(ids, self.pixels[[where[int(number)] for number in ids]])


@dataclass(frozen=True)
class Board:
    """A ChArUco board.

    Attributes:
        columns: Squares across, 3 or more.
        rows: Squares down, 3 or more.
        square: Side of a square on the printed board [m].
        dictionary: Of its markers, one of ``DICTIONARIES``.
    """

    columns: int = 11
    rows: int = 8
    square: float = 0.005
    dictionary: str = "DICT_4X4_100"

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            BoardError: One of them is out of its range.
        """
        if not (3 <= self.columns <= 30 and 3 <= self.rows <= 30):
            raise BoardError(f"squares: {self.columns}x{self.rows}; allowed: 3x3 to 30x30")
        if not 0.0005 <= self.square <= 0.1:
            raise BoardError(f"square: {1e3 * self.square:g} mm; allowed: 0.5 to 100 mm")
        if self.dictionary not in DICTIONARIES:
            raise BoardError(f"dictionary: {self.dictionary}; allowed: {', '.join(DICTIONARIES)}")
        most = int(self.dictionary.rpartition("_")[2])
        if self.columns * self.rows // 2 > most:
            raise BoardError(
                f"squares: {self.columns}x{self.rows} need {self.columns * self.rows // 2} "
                f"markers; {self.dictionary} has {most}"
            )

    @property
    def corners(self) -> FloatArray:
        """Inner corners (n, 3) in the board frame [m], in the order of their numbers."""
        row, column = np.divmod(
            np.arange((self.columns - 1) * (self.rows - 1)), max(1, self.columns - 1)
        )
        x, y = self.square * (column + 1), self.square * (self.rows - 1 - row)
        return np.column_stack([x, y, np.zeros(len(x))])

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the pattern [m]."""
        return self.columns * self.square, self.rows * self.square

    def picture(self, pixels: int = 40) -> Picture:
        """The pattern from above, (rows * pixels, columns * pixels), grey, without a margin."""
        size = (self.columns * pixels, self.rows * pixels)
        pattern = _pattern(self)
        drawn = pattern.draw(size) if hasattr(pattern, "draw") else pattern.generateImage(size)
        return np.asarray(drawn, dtype=np.uint8)

    def find(self, picture: Picture) -> Corners | None:
        """The corners that a picture (h, w) or (h, w, 3) shows.

        None: there are fewer than eight, or they do not lie as on this board.
        """
        found = self._seen(picture)
        if found is None or not self._lies_as_stated(found):
            return None
        return None if self._is_older(_grey(picture)) else found

    def _seen(self, picture: Picture) -> Corners | None:
        """The corners of a picture, wherever they lie; None: fewer than eight."""
        grey = _grey(picture)
        pixels, ids = _charuco(grey, _pattern(self), self.dictionary)
        if ids is None or len(ids) < LEAST_CORNERS:
            return None
        found = Corners(
            np.asarray(ids, dtype=np.int64).ravel(),
            np.asarray(pixels, dtype=np.float64).reshape(-1, 2) - EDGE_TO_CENTRE,
        )
        return Corners(found.ids, self._refined(grey, found))

    def _lies_as_stated(self, found: Corners) -> bool:
        """Whether the corners are a flat board's, up to what a lens bends.

        Markers of a board with another number of columns are numbered otherwise: their corners
        are two squares or more off. A barrel lens bends a board by less than a tenth of a square.
        """
        flat = self.corners[found.ids][:, :2]
        return _misfit(flat, found.pixels) <= LARGEST_BEND * self.side_in(found)

    def side_in(self, found: Corners) -> float:
        """Side of a square in a picture, median over neighbours [px]; 0: none are seen."""
        row = {int(number): row for row, number in enumerate(found.ids)}
        sides = [
            float(np.linalg.norm(found.pixels[row[number]] - found.pixels[row[number + step]]))
            for number in row
            for step in (1, self.columns - 1)
            if number + step in row and not (step == 1 and (number + 1) % (self.columns - 1) == 0)
        ]
        return float(np.median(sides)) if sides else 0.0

    def _refined(self, grey: Picture, found: Corners) -> FloatArray:
        """Pixels (n, 2) of the corners, refined in windows that fit the squares in the picture."""
        half = max(2, round(WINDOW_SHARE * self.side_in(found)))
        start = np.array(found.pixels[:, None], dtype=np.float32, order="C")
        ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
        refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), ends)[:, 0]
        return np.asarray(refined, dtype=np.float64)

    def why_not(self, picture: Picture) -> str:
        """Why a picture does not show the board, as far as it can be told."""
        grey = _grey(picture)
        if self.find(np.ascontiguousarray(grey[:, ::-1])) is not None:
            return "the picture is mirrored; set the camera's flip"
        for name in DICTIONARIES:
            count = _markers(grey, name)
            if name != self.dictionary and count > max(4, 2 * _markers(grey, self.dictionary)):
                return f"the markers are of {name}, the board is stated as {self.dictionary}"
        if self._is_older(grey):
            return (
                "its upper left square is white: the pattern of OpenCV before 4.6. Print the board"
                " of ./surg calibrate CELL board"
            )
        seen = self._seen(grey)
        if seen is not None and not self._lies_as_stated(seen):
            return (
                f"its corners do not lie as on {self.columns}x{self.rows} squares: count them, and "
                "state them by ./surg calibrate CELL board --board"
            )
        if _markers(grey, self.dictionary):
            return (
                "its markers are seen, but fewer than eight corners; show more of the board, and "
                f"check that it has {self.columns}x{self.rows} squares"
            )
        return "no marker is seen; the picture is blurred, dark or does not show the board"

    def _is_older(self, grey: Picture) -> bool:
        """Whether the markers lie on the squares that are black on this board."""
        centres, ids = _centres(grey, self.dictionary)
        squares = np.array(np.divmod(np.arange(self.rows * self.columns), self.columns)).T[:, ::-1]
        black = squares.sum(axis=1) % 2 == 0
        away = []
        for layout in (squares[black], squares[~black]):
            known = ids < len(layout)
            if known.sum() < LEAST_CORNERS:
                return False
            away.append(_misfit(centres[known], layout[ids[known]].astype(np.float64)))
        return away[0] <= LARGEST_BEND / 2 < away[1] < math.inf


def _grey(picture: Picture) -> Picture:
    """A picture (h, w) or (h, w, 3) as (h, w), contiguous."""
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(grey)


def _misfit(places: FloatArray, seen: FloatArray) -> float:
    """Distance of places (n, 2) in perspective from where they are seen, rms; infinite: no fit."""
    H, _ = cv2.findHomography(places, seen)
    if H is None:
        return math.inf
    away = cv2.perspectiveTransform(places[None], H)[0] - seen
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def printed_square(square: float, measured_mm: float) -> float:
    """Side of a printed square [m] where the ruler of 100 mm measures ``measured_mm``.

    Raises:
        BoardError: The print is more than 5 % off its size.
    """
    if not abs(measured_mm / 100.0 - 1.0) <= LARGEST_STRETCH:  # written so that NaN is refused
        raise BoardError(
            f"measured: {measured_mm:g} mm for the ruler of 100 mm; allowed: 95 to 105 mm; print "
            "it at 100 %, without fitting it to the page"
        )
    return square * measured_mm / 100.0


def write_picture(file: Path, board: Board, pixels: int = 60) -> None:
    """Write the pattern as a picture with so many pixels for each square, without a margin.

    Raises:
        OSError: It cannot be written.
    """
    if not cv2.imwrite(str(file), board.picture(pixels)):
        raise OSError(f"{file}: cannot be written")


def _charuco(grey: Picture, pattern: Any, dictionary: str) -> tuple[Any, Any]:
    """Corners and their numbers, counted from the picture's edge; (None, None): none."""
    if hasattr(cv2.aruco, "CharucoDetector"):  # OpenCV 4.7 and later
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
        return pixels, ids
    markers, ids, _ = cv2.aruco.detectMarkers(grey, _dictionary(dictionary))
    if ids is None:
        return None, None
    _, pixels, numbers = cv2.aruco.interpolateCornersCharuco(markers, ids, grey, pattern)
    return pixels, numbers


def _centres(grey: Picture, dictionary: str) -> tuple[FloatArray, NDArray[np.int64]]:
    """Centres (n, 2) [px] and numbers (n,) of the markers of a dictionary in a picture."""
    found = _dictionary(dictionary)
    if hasattr(cv2.aruco, "ArucoDetector"):
        corners, ids, _ = cv2.aruco.ArucoDetector(found).detectMarkers(grey)
    else:
        corners, ids, _ = cv2.aruco.detectMarkers(grey, found)
    if ids is None:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    centres = np.array([corner.reshape(4, 2).mean(axis=0) for corner in corners], np.float64)
    return centres, np.asarray(ids, np.int64).ravel()


def _markers(grey: Picture, dictionary: str) -> int:
    """Number of markers of a dictionary in a picture."""
    return len(_centres(grey, dictionary)[1])


def _dictionary(name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _pattern(board: Board) -> Any:
    """OpenCV's board. The constructor of later versions crashes in 4.6, which has another one."""
    side, marker = board.square, MARKER_SHARE * board.square
    dictionary = _dictionary(board.dictionary)
    if hasattr(cv2.aruco, "CharucoBoard_create"):
        return cv2.aruco.CharucoBoard_create(board.columns, board.rows, side, marker, dictionary)
    return cv2.aruco.CharucoBoard((board.columns, board.rows), side, marker, dictionary)
