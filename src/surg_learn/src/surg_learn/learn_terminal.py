"""What the stages tell a person, and the error that ends them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol


class LearnError(Exception):
    """A stage, or what was asked for, cannot be done; the text says why, and what to do.

    ``code``: 1 for a stage that failed, 2 for wrong input.
    """

    def __init__(self, text: str, code: int = 1) -> None:
        super().__init__(text)
        self.code = code


class ProgressLine(Protocol):
    """One line that says how far some work is."""

    def update(self, fraction: float | None, note: str = "") -> None:
        """Show the finished share, 0 to 1 (None: unknown), and a few words."""


class Terminal(Protocol):
    """Where the stages write; `surg_cli.host.terminal` is one."""

    @property
    def say(self) -> Callable[[str], None]:
        """Print one line of news."""

    @property
    def Progress(self) -> Callable[[str], AbstractContextManager[ProgressLine]]:
        """Make the line of some work, from its title."""
