"""The one reader of text tables that people and other programs write: a header, then rows.

Read are UTF-8 and UTF-16 with or without a byte order mark, every kind of line end, commas,
semicolons, tabs or blanks between the columns, quotes, and decimal commas where the comma separates
nothing. Lines that begin with ``#`` are comments.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from surg_core.config import PathLike

Refusal = Callable[[str], Exception]
"""Makes the caller's kind of exception from a message."""

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_SEPARATORS = (";", "\t", ",")
"""In the order in which they are looked for: a semicolon or tab leaves the comma to decimals."""
_DECIMAL_COMMA = re.compile(r"([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)")


@dataclass(frozen=True)
class Row:
    """One row of a table.

    Attributes:
        file: Of the table.
        line: In the file, the first is 1.
        words: By column.
        refusal: Of the caller.
    """

    file: str
    line: int
    words: Mapping[str, str]
    refusal: Refusal

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.file}:{self.line}"

    def number(self, name: str) -> float:
        """The finite number of a column; the caller's exception if it is none."""
        word = self.words[name]
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.refusal(f"{self.where}: {name}: '{word}' is not a finite number")
        return value


def read_table(path: PathLike, refusal: Refusal) -> tuple[tuple[str, ...], list[Row]]:
    """Column names and rows of a table.

    Args:
        path: Of the file.
        refusal: Makes the exception that is raised: the file cannot be read, is no text, is empty,
            names a column twice, or a row has another number of values than the header.
    """
    lines = [
        (number, line)
        for number, line in enumerate(re.split(r"\r\n|\r|\n", _text(path, refusal)), start=1)
        if line.strip() and line.lstrip()[0] != "#" and not re.fullmatch(r"sep=.", line)
    ]
    if not lines:
        raise refusal(f"{path}: is empty; a header and rows are needed")
    mark = next((mark for mark in _SEPARATORS if mark in lines[0][1]), None)
    header = tuple(_words(path, *lines[0], mark, refusal))
    if twice := sorted({name for name in header if header.count(name) > 1}):
        raise refusal(f"{path}:{lines[0][0]}: column {', '.join(twice)} is there twice")
    rows = []
    for number, line in lines[1:]:
        words = _words(path, number, line, mark, refusal)
        if len(words) != len(header):
            raise refusal(
                f"{path}:{number}: {len(words)} values; the header has {len(header)}. A comma in"
                " decimals needs semicolons or tabs between the columns"
            )
        if not any(words):
            continue
        if mark != ",":
            words = [_DECIMAL_COMMA.sub(r"\1.\2", w) if _is_decimal(w) else w for w in words]
        rows.append(Row(str(path), number, dict(zip(header, words, strict=True)), refusal))
    return header, rows


def _is_decimal(word: str) -> bool:
    return _DECIMAL_COMMA.fullmatch(word) is not None


def _text(path: PathLike, refusal: Refusal) -> str:
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise refusal(f"{path}: cannot be read: {error.strerror or error}") from error
    coding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(coding)
    except UnicodeDecodeError as error:
        raise refusal(f"{path}: is not a text file in UTF-8: {error.reason}") from error
    if "\0" in text:
        raise refusal(f"{path}: is not a text file: it holds a byte 0")
    return text


def _words(path: PathLike, number: int, line: str, mark: str | None, refusal: Refusal) -> list[str]:
    if mark is None:
        return line.split()
    try:
        (words,) = csv.reader([line], delimiter=mark, skipinitialspace=True, strict=True)
    except (csv.Error, ValueError) as error:
        raise refusal(f"{path}:{number}: is no row of a table: {error}") from error
    return [word.strip() for word in words]
