"""``board.yaml``, surg_board/1: which board was printed, and how large its squares really are."""

from __future__ import annotations

import re
from pathlib import Path

import surg_core
from surg_core.replace_file import replace_file
from surg_perception.calibration.board import Board, BoardError

FORMAT = "surg_board/1"
KEYS = ("format", "squares", "square", "dictionary")


def write_board(path: Path, board: Board) -> None:
    """Write a board; the old file stays as ``board.yaml.previous``."""
    text = (
        "# The printed calibration board: ./surg calibrate CELL board\n"
        f"format: {FORMAT}\n"
        f'squares: "{board.columns}x{board.rows}"\n'
        f"square: {board.square:.9f}  # m, as measured on the print\n"
        f"dictionary: {board.dictionary}\n"
    )
    replace_file(path, text, load_board)


def load_board(path: Path) -> Board:
    """Read a board.

    Raises:
        ConfigError: A key is missing, unknown or out of its range.
    """
    values = surg_core.read_document(path).values
    if unknown := sorted(set(values) - set(KEYS)):
        raise surg_core.ConfigError(f"{path}: {unknown[0]}: unknown; allowed: {', '.join(KEYS)}")
    if missing := [key for key in KEYS if key not in values]:
        raise surg_core.ConfigError(f"{path}: {missing[0]}: is missing")
    if values["format"] != FORMAT:
        raise surg_core.ConfigError(f"{path}: format: {values['format']!r}; allowed: {FORMAT}")
    square = values["square"]
    if not isinstance(square, float):
        raise surg_core.ConfigError(f"{path}: square: {square!r}; allowed: 0.0005 to 0.1 m")
    try:
        columns, rows = parse_squares(str(values["squares"]))
        return Board(columns, rows, square, str(values["dictionary"]))
    except BoardError as error:
        raise surg_core.ConfigError(f"{path}: {error}") from error


def parse_squares(text: str) -> tuple[int, int]:
    """Columns and rows of ``11x8``.

    Raises:
        BoardError: The text is no such pair.
    """
    match = re.fullmatch(r"(\d{1,2})x(\d{1,2})", text)
    if match is None:
        raise BoardError(f"squares: {text!r}; allowed: columns x rows, such as 11x8")
    return int(match[1]), int(match[2])
