"""What an export tells: its progress, its report, and the error that ends it."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Progress = Callable[[float | None, str], None]
"""Called with the done part in [0, 1] and a few words."""


class ExportError(Exception):
    """An export that cannot be done at all; the message says what to do."""


@dataclasses.dataclass
class Report:
    """Result of an export or of a check of one."""

    format: str
    out: Path
    recordings: int = 0
    frames: int = 0
    made: int = 0
    """Recordings converted in this run; the others were there already."""
    refused: dict[str, str] = dataclasses.field(default_factory=dict)
    """Recording → why it is not in the export."""
    errors: list[str] = dataclasses.field(default_factory=list)
    """What is wrong with the export; empty if it is good."""
    warnings: list[str] = dataclasses.field(default_factory=list)
    facts: dict[str, Any] = dataclasses.field(default_factory=dict)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Damaged files fail in many ways: every exception becomes an error of the report."""
        try:
            yield
        except Exception as problem:
            self.errors.append(f"{type(problem).__name__}: {problem}")

    @property
    def ok(self) -> bool:
        """The export is good, and contains every recording."""
        return not self.errors and not self.refused

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return {**dataclasses.asdict(self), "out": str(self.out), "ok": self.ok}
