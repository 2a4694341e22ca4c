"""A folder of views: pairs of pictures and the joints of all arms. The folder is the interface.

::

    views.csv                    view,stamp,touch,PSM1/shoulder_pan_joint,...,ECM/...
    000_left.png 000_right.png   of the view 000
    board.yaml                   the board (optional: the cell's own calibration/board.yaml)

``stamp`` is in seconds, joints in rad. ``touch`` is the number of the corner that an instrument
touches, empty for none. ``tip_left_x``, ``tip_left_y``, ``tip_right_x``, ``tip_right_y`` are the
pixels of an instrument's tip, for bases by tip. Without a right picture there is one eye. Deleting
a row, or both pictures of a view, leaves it out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from surg_core.reading.text_table import Row, read_table
from surg_core.transforms import FloatArray
from surg_perception.calibration.board import Board, Corners, Picture
from surg_perception.calibration.intrinsics import SeenCorners

EYES = ("left", "right")
TIP = ("tip_left_x", "tip_left_y", "tip_right_x", "tip_right_y")
"""Columns with the pixels of an instrument's tip."""


class ViewsError(ValueError):
    """A folder of views must not be used; names file, line and what to do."""


@dataclass(frozen=True)
class View:
    """One rest.

    Attributes:
        name: Of the view, such as ``007``.
        stamp: Of the exposure [s].
        joints: Positions by ``<arm>/<joint>`` [rad].
        touch: Corner that an instrument touches; None: none.
        corners: What each eye sees: left, right; None: the board is not seen.
        tip: ``(4,)`` an instrument's tip: x, y in the left, x, y in the right picture [px]; None:
            not stated.
    """

    name: str
    stamp: float
    joints: Mapping[str, float]
    touch: int | None
    corners: tuple[Corners | None, Corners | None]
    tip: FloatArray | None = None

    def of_arm(self, arm: str, joints: Sequence[str]) -> FloatArray:
        """Joint positions (n,) of an arm [rad].

        Raises:
            ViewsError: The folder does not have them.
        """
        missing = [joint for joint in joints if f"{arm}/{joint}" not in self.joints]
        if missing:
            raise ViewsError(
                f"view {self.name}: no column {arm}/{missing[0]}: the joints of {arm} are silent; "
                "record the views while its state is published"
            )
        return np.array([self.joints[f"{arm}/{joint}"] for joint in joints])

    def seen(self, board: Board, eyes: int = 2) -> tuple[SeenCorners, SeenCorners] | None:
        """What both eyes see; None: one of them does not see the board.

        Args:
            board: What is seen.
            eyes: 1: the right eye is left out; it sees no corner then.
        """
        left, right = self.corners
        if eyes == 1:
            right = Corners(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        if left is None or right is None:
            return None
        places = board.corners
        return (
            SeenCorners(places[left.ids], left.pixels),
            SeenCorners(places[right.ids], right.pixels),
        )


@dataclass(frozen=True)
class Views:
    """The views of a folder.

    Attributes:
        folder: Where they come from.
        board: What they show.
        size: Width and height of the pictures [px].
        views: In the order of the file.
        skipped: Views without the board in an eye, each with the reason.
    """

    folder: Path
    board: Board
    size: tuple[int, int]
    views: Sequence[View]
    skipped: Sequence[str]

    def with_board(self, eyes: int = 2) -> list[View]:
        """The views that show the board to both eyes, or with ``eyes`` 1 to the left one."""
        return [view for view in self.views if view.seen(self.board, eyes) is not None]


def read_views(folder: Path, board: Board, look: bool = True) -> Views:
    """Read a folder and find the board in its pictures.

    Args:
        folder: Of the views.
        board: What they show.
        look: Whether the board is looked for; False: the pictures show something else.

    Raises:
        ViewsError: The folder, its table or a picture must not be used.
    """
    file = folder / "views.csv"
    header, rows = read_table(file, ViewsError)
    if not rows:
        raise ViewsError(f"{file}: has no views; a header and rows are needed")
    if missing := [key for key in ("view", "stamp") if key not in header]:
        raise ViewsError(f"{file}: no column '{missing[0]}'; needed are view, stamp and joints")
    views, skipped = [], []
    sizes: dict[tuple[int, int], str] = {}
    for row in rows:
        name, where = row.words["view"], row.where
        if not name or not name.replace("_", "").replace("-", "").isalnum():
            raise ViewsError(f"{where}: view: {name!r}; allowed: letters, digits, '-', '_'")
        pictures = [_picture(folder / f"{name}_{eye}.png") for eye in EYES]
        if pictures[0] is None:
            skipped.append(f"{name}: no picture {name}_left.png")
            continue
        sizes.update({(p.shape[1], p.shape[0]): name for p in pictures if p is not None})
        if len(sizes) > 1:
            (a, first), (b, second) = list(sizes.items())[:2]
            raise ViewsError(
                f"{folder}: view {first} has {a[0]} x {a[1]} px, view {second} {b[0]} x {b[1]}; "
                "all pictures must have one size"
            )
        corners = [board.find(p) if look and p is not None else None for p in pictures]
        for eye, picture, found in zip(EYES, pictures, corners, strict=True):
            if look and picture is not None and found is None:
                skipped.append(f"{name}_{eye}.png: {board.why_not(picture)}")
        views.append(_view(name, row, (corners[0], corners[1]), board))
    if not sizes:
        raise ViewsError(
            f"{folder}: has no pictures; needed are {rows[0].words['view']}_left.png, ..."
        )
    return Views(folder, board, next(iter(sizes)), views, skipped)


def _view(
    name: str, row: Row, corners: tuple[Corners | None, Corners | None], board: Board
) -> View:
    """One row of the table."""
    known = ("view", "stamp", "touch", *TIP)
    joints = {key: row.number(key) for key in row.words if key not in known}
    touch = row.words.get("touch") or ""
    if touch and not (touch.isdigit() and int(touch) < len(board.corners)):
        raise ViewsError(
            f"{row.where}: touch: {touch!r}; allowed: a corner from 0 to {len(board.corners) - 1}"
        )
    tip = None
    if any(row.words.get(key) for key in TIP):
        missing = [key for key in TIP if key not in row.words]
        if missing:
            raise ViewsError(
                f"{row.where}: no column {missing[0]}; allowed: all of {', '.join(TIP)}"
            )
        tip = np.array([row.number(key) for key in TIP])
    return View(name, row.number("stamp"), joints, int(touch) if touch else None, corners, tip)


def _picture(file: Path) -> Picture | None:
    """A grey picture (h, w); None: there is none.

    Raises:
        ViewsError: It is no picture.
    """
    if not file.is_file():
        return None
    data = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if picture is None:
        raise ViewsError(f"{file}: is not a picture; delete it, or record the view again")
    return np.asarray(picture, dtype=np.uint8)
