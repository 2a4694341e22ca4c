"""Threads of a URScript program: their calls, the variables of each, and what they wait for."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any

from surg_emulators.ur.urscript_syntax import Function

Builtin = Callable[..., Any]
"""A function of the controller."""
Steps = Generator["Scope | Wait | None", Any, Any]
"""A piece of a program under way. It yields the call or the wait that it needs; None: its thread
may have been killed."""


@dataclass
class Wait:
    """What a function returns to let its thread wait.

    Attributes:
        cycles: Cycles to wait.
        until: Ends the wait when it returns True; asked once per cycle after `cycles`.
        motion: Whether the thread controls the motion meanwhile.
        answer: Gives the value of the call, once it is over.
    """

    cycles: int = 1
    until: Callable[[], bool] | None = None
    motion: bool = False
    answer: Callable[[], Any] | None = None

    def over(self) -> bool:
        """Count one cycle; whether the thread goes on in it."""
        self.cycles -= 1
        return self.cycles <= 0 and (self.until is None or self.until())


@dataclass
class Scope:
    """Variables of one call, and the call itself."""

    function: Function
    outer: Scope | None
    values: dict[str, Any] = field(default_factory=dict)
    line: int = 0  # of the statement that it is in
    run: Steps | None = None

    def holder(self, name: str) -> Scope | None:
        """The nearest scope that has a variable."""
        here: Scope | None = self
        while here is not None and name not in here.values:
            here = here.outer
        return here


@dataclass
class Thread:
    """One thread of a program: its calls, the innermost last."""

    calls: list[Scope]
    wait: Wait | None = None
    answer: Any = None  # of the call that has ended

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return bool(self.calls)

    @property
    def line(self) -> int:
        """Line of the script that it is in."""
        return self.calls[-1].line if self.calls else 0


@dataclass(frozen=True)
class Leave:
    """Why a block was left before its end: `break`, `continue` or `return` with a value."""

    how: str
    value: Any = None
