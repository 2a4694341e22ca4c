"""Text protocol of faults: what goes wrong with an emulated arm, and when.

One fault per line: `[at SECONDS] NAME [WORD ...]`. Text behind `#` is a comment. The time counts
from the moment when the line was read. Lines come from a file or over the control port; there each
line is answered by `ok` or `error: ...`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar


class FaultError(ValueError):
    """A line that is no fault; states what is wrong and what is allowed."""


@dataclass(frozen=True)
class Fault:
    """One line.

    Attributes:
        delay: Seconds from reading it.
        name: What happens.
        words: Its arguments.
    """

    delay: float
    name: str
    words: tuple[str, ...]


Action = Callable[..., str | None]
Value = TypeVar("Value")


@dataclass(frozen=True)
class Kind:
    """A fault that an emulator knows.

    Attributes:
        action: What it does; takes the words of the line.
        words: Its arguments, for people.
        help: What happens.
    """

    action: Action
    words: str
    help: str


def parse(line: str) -> Fault | None:
    """The fault of a line; None: the line is empty.

    Raises:
        FaultError: The time is no number of seconds from 0.
    """
    words = line.partition("#")[0].split()
    delay = 0.0
    if words[:1] == ["at"]:
        delay = number(words[1] if len(words) > 1 else "", "at", 0.0, 1e6)
        words = words[2:]
        if not words:
            raise FaultError(f"{line.strip()!r}: a name must follow the time")
    return Fault(delay, words[0], tuple(words[1:])) if words else None


def number(word: str, what: str, least: float, most: float) -> float:
    """A number within its range.

    Raises:
        FaultError: It is not.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise FaultError(f"{what} {word!r}: must be a number from {least:g} to {most:g}")
    return value


def numbers(words: Sequence[str], count: int, what: str, most: float) -> list[float]:
    """So many numbers of at most a magnitude; no words are zeros.

    Raises:
        FaultError: They are not.
    """
    values = [number(word, what, -most, most) for word in words] or [0.0] * count
    if len(values) != count:
        raise FaultError(f"{what}: {len(values)} numbers; {count} are needed")
    return values


def choice(word: str, choices: Mapping[str, Value], what: str) -> Value:
    """What a word stands for.

    Raises:
        FaultError: It is none of the choices.
    """
    if word not in choices:
        raise FaultError(f"{what} {word!r}: must be one of {', '.join(choices)}")
    return choices[word]


def switch(word: str) -> bool:
    """`on` or `off`.

    Raises:
        FaultError: It is neither.
    """
    return choice(word, {"on": True, "off": False}, "switch")


class Schedule:
    """Faults that are still to come, on the emulator's own time.

    Args:
        kinds: Name -> fault that this emulator knows.
    """

    def __init__(self, kinds: Mapping[str, Kind]) -> None:
        self._kinds = kinds
        self._waiting: list[tuple[float, Fault]] = []

    def read(self, text: str, now: float) -> None:
        """Take over the lines of a file.

        Args:
            text: The lines.
            now: The emulator's time [s].

        Raises:
            FaultError: A line is wrong; states which one. Nothing has been taken over then.
        """
        taken = []
        for place, line in enumerate(text.splitlines(), 1):
            try:
                fault = parse(line)
                if fault is not None:
                    self._kind(fault)
                    taken.append((now + fault.delay, fault))
            except FaultError as error:
                raise FaultError(f"line {place}: {error}") from error
        self._waiting = sorted([*self._waiting, *taken], key=lambda each: each[0])

    def answer(self, line: str, now: float) -> str:
        """Carry out or schedule a line of the control port; returns the answer."""
        try:
            fault = parse(line)
            if fault is None:
                return "ok"
            if fault.delay == 0.0:
                return self._carry_out(fault)
            self.read(line, now)
        except FaultError as error:
            return f"error: {error}"
        return "ok"

    def due(self, now: float) -> list[str]:
        """Carry out what is due; returns one sentence for each."""
        said = []
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            fault = self._waiting.pop(0)[1]
            try:
                answer = self._carry_out(fault)
            except FaultError as error:
                answer = f"error: {error}"
            said.append(f"{' '.join([fault.name, *fault.words])}: {answer}")
        return said

    def help(self) -> str:
        """All faults, one per line."""
        rows = [(f"{name} {kind.words}".strip(), kind.help) for name, kind in self._kinds.items()]
        width = max(len(usage) for usage, _ in rows)
        return "\n".join(f"{usage:<{width}}  {text}" for usage, text in rows)

    def _kind(self, fault: Fault) -> Kind:
        if fault.name not in self._kinds:
            known = ", ".join(self._kinds)
            raise FaultError(f"{fault.name!r} is not known; there are: {known}")
        return self._kinds[fault.name]

    def _carry_out(self, fault: Fault) -> str:
        kind = self._kind(fault)
        try:
            inspect.signature(kind.action).bind(*fault.words)
        except TypeError as error:
            raise FaultError(
                f"{fault.name} takes: {kind.words or 'no arguments'}; given: "
                f"{' '.join(fault.words) or 'none'}"
            ) from error
        return kind.action(*fault.words) or "ok"
