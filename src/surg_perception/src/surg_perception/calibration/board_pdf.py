"""The board as a PDF page with a ruler: vectors only, so that a printer keeps the edges."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from surg_perception.calibration.board import Board, BoardError

PAGE = (297.0, 210.0)
"""A4, landscape [mm]."""
RULER = 100.0
"""[mm]"""
MARGIN = 12.0
"""[mm]"""
_INCH = 25.4  # [mm]
Box = tuple[float, float, float, float]
"""Left, bottom, width and height of a black rectangle [mm]."""


def board_pdf(board: Board) -> bytes:
    """A page with the board in the middle and a ruler of 100 mm below it.

    Raises:
        BoardError: The board does not fit on the page.
    """
    wide, high = (1e3 * side for side in board.size)
    if wide > PAGE[0] - 2 * MARGIN or high > PAGE[1] - 2 * MARGIN - 20.0:
        raise BoardError(
            f"the board measures {wide:g} x {high:g} mm; allowed on A4: {PAGE[0] - 2 * MARGIN:g} x "
            f"{PAGE[1] - 2 * MARGIN - 20:g} mm; take fewer or smaller squares"
        )
    left, low = (PAGE[0] - wide) / 2, (PAGE[1] - high) / 2 + 5.0
    figure = Figure(figsize=(PAGE[0] / _INCH, PAGE[1] / _INCH), frameon=False)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, PAGE[0]), ylim=(0.0, PAGE[1]))
    axes.set_axis_off()
    for x, y, width, height in _squares(board, left, low) + _ruler(low - 14.0):
        axes.add_patch(Rectangle((x, y), width, height, facecolor="black", linewidth=0.0))
    text = (
        f"{board.columns}x{board.rows} squares of {1e3 * board.square:g} mm, {board.dictionary}. "
        "Print at 100 %. Measure the ruler: 100 mm?"
    )
    axes.text(left, low - 22.0, text, fontsize=9.0)
    page = io.BytesIO()
    figure.savefig(page, format="pdf", metadata={"CreationDate": None})
    return page.getvalue()


def _squares(board: Board, left: float, low: float) -> list[Box]:
    """Black squares and markers, from the pattern's own picture."""
    # Six cells across a marker, in 70 % of a square: sixty pixels make all edges whole ones.
    pixels = 60
    dark = np.asarray(board.picture(pixels) < 128, np.int8)
    cell = 1e3 * board.square / pixels
    firsts = np.flatnonzero(np.any(np.diff(dark, axis=0, prepend=-1), axis=1))
    boxes = []
    for first, end in zip(firsts, [*firsts[1:], len(dark)], strict=True):
        edges = np.flatnonzero(np.diff(dark[first], prepend=0, append=0))
        for start, stop in edges.reshape(-1, 2):
            bottom = low + (len(dark) - end) * cell
            size = ((stop - start) * cell, (end - first) * cell)
            boxes.append((left + start * cell, bottom, *size))
    return boxes


def _ruler(low: float) -> list[Box]:
    """A line with marks every 10 mm; the outer edges of the end marks are 100 mm apart."""
    left = (PAGE[0] - RULER) / 2
    boxes = [(left, low, RULER, 0.2)]
    for number in range(11):
        x = left + number * 10.0 - (0.2 if number == 10 else 0.0 if number == 0 else 0.1)
        boxes.append((x, low, 0.2, 4.0 if number % 5 == 0 else 2.5))
    return boxes
