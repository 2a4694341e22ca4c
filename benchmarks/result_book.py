"""Results in a file that grows by a line for each, so that a call that was cut off goes on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

K = TypeVar("K")
R = TypeVar("R")


class ResultBook(Generic[K, R]):
    """A file of results.

    Args:
        file: Read if it exists. A last line that was cut off is taken away: it is done again.
        kind: A dataclass of numbers, texts and lists.
        key: Of a result; the newest of a key counts.

    Attributes:
        found: Results by key.

    Raises:
        ValueError: A line of the file is no result; with file and line.
    """

    def __init__(self, file: Path, kind: Callable[..., R], key: Callable[[R], K]) -> None:
        self._file, self._key = file, key
        self.found: dict[K, R] = {}
        text = file.read_text("utf-8") if file.exists() else ""
        lines = text.splitlines(keepends=True)
        if lines and not lines[-1].endswith("\n"):
            file.write_text("".join(lines[:-1]), "utf-8")
            lines.pop()
        for n, line in enumerate(lines, 1):
            try:
                self._keep(kind(**json.loads(line)))
            except (ValueError, TypeError) as error:
                raise ValueError(f"{file}:{n}: no roll-out ({error}); remove it") from None

    def _keep(self, result: R) -> None:
        self.found[self._key(result)] = result

    def add(self, result: Any) -> None:
        """Keep a result."""
        self._keep(result)
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(result)) + "\n")
