"""The board as a PDF page with a ruler: vectors only, so that a printer keeps the edges."""

from __future__ import annotations

import numpy as np

from surg_perception.calibration.board import Board, BoardError

PAGE = (297.0, 210.0)
"""A4, landscape [mm]."""
RULER = 100.0
"""[mm]"""
MARGIN = 12.0
"""[mm]"""
_POINT = 72.0 / 25.4


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
    marks = _squares(board, left, low) + _ruler((PAGE[0] - RULER) / 2, low - 14.0)
    text = (
        f"{board.columns}x{board.rows} squares of {1e3 * board.square:g} mm, {board.dictionary}. "
        "Print at 100 %. Measure the ruler: 100 mm?"
    )
    marks.append(f"BT /F1 9 Tf {left * _POINT:.2f} {(low - 22.0) * _POINT:.2f} Td ({text}) Tj ET")
    return _document("\n".join(marks).encode("ascii"))


def _squares(board: Board, left: float, low: float) -> list[str]:
    """Black squares and markers as filled rectangles, from the pattern's own picture."""
    # Six cells across a marker, in 70 % of a square: sixty pixels make all edges whole ones.
    pixels = 60
    dark = board.picture(pixels) < 128
    cell = 1e3 * board.square / pixels
    rows = []
    for row in range(len(dark)):
        if row and np.array_equal(dark[row], dark[row - 1]):
            continue
        same = 1
        while row + same < len(dark) and np.array_equal(dark[row + same], dark[row]):
            same += 1
        edges = np.flatnonzero(np.diff(np.concatenate([[0], dark[row].astype(np.int8), [0]])))
        for start, end in edges.reshape(-1, 2):
            bottom = low + (len(dark) - row - same) * cell
            rows.append(_rectangle(left + start * cell, bottom, (end - start) * cell, same * cell))
    return rows


def _ruler(left: float, low: float) -> list[str]:
    """A line with marks every 10 mm; the outer edges of the end marks are 100 mm apart."""
    marks = [_rectangle(left, low, RULER, 0.2)]
    for number in range(11):
        x = left + number * 10.0 - (0.2 if number == 10 else 0.0 if number == 0 else 0.1)
        marks.append(_rectangle(x, low, 0.2, 4.0 if number % 5 == 0 else 2.5))
    return marks


def _rectangle(x: float, y: float, width: float, height: float) -> str:
    return " ".join(f"{_POINT * value:.4f}" for value in (x, y, width, height)) + " re f"


def _document(content: bytes) -> bytes:
    """A PDF 1.4 file of one page (ISO 32000-1, 7.5)."""
    box = f"0 0 {PAGE[0] * _POINT:.2f} {PAGE[1] * _POINT:.2f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents 4 0 R /Resources "
        "<< /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    body, offsets = b"%PDF-1.4\n", []
    for number, each in enumerate(objects, start=1):
        offsets.append(len(body))
        body += b"%d 0 obj\n%s\nendobj\n" % (number, each)
    table = b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    table += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    tail = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n"
    return body + table + tail % (len(objects) + 1, len(body))
