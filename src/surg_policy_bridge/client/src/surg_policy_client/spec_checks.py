"""Checks of the parts of a specification; each names the place and what is allowed."""

from __future__ import annotations

import math
from typing import Any, Callable, Sequence

MAX_NDIM = 4
MAX_SIDE = 1 << 16
MAX_NAMES = 1024
MAX_TEXT = 256


class SpecError(ValueError):
    """An invalid specification; the message names the place and what is allowed."""


def map_of(value: Any, where: str, keys: Sequence[str]) -> dict[str, Any]:
    """A map with exactly these keys."""
    if not isinstance(value, dict):
        raise SpecError(f"{where}: a map, not {type(value).__name__}")
    if set(value) != set(keys):
        raise SpecError(f"{where}: exactly the keys {', '.join(keys)}, not {shown(list(value))}")
    return value


def maybe(check: Callable[[Any, str], Any]) -> Callable[[Any, str], Any]:
    """Check the value unless it is None."""
    return lambda value, where: None if value is None else check(value, where)


def text(value: Any, where: str) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT:
        raise SpecError(f"{where}: a text of 1 to {MAX_TEXT} characters, not {shown(value)}")
    return value


def texts(value: Any, where: str) -> tuple[str, ...]:
    """A list of texts."""
    return tuple(text(item, where) for item in list_of(value, where))


def number(value: Any, where: str) -> float:
    """A finite number."""
    if type(value) not in (int, float) or not abs(value) < 1e300 or math.isnan(value):
        raise SpecError(f"{where}: a finite number, not {shown(value)}")
    return float(value)


def numbers(value: Any, where: str) -> tuple[float, ...]:
    """A list of finite numbers."""
    return tuple(number(item, where) for item in list_of(value, where))


def shape(value: Any, where: str) -> tuple[int, ...]:
    """Sides of an array."""
    sides = list_of(value, where)
    if len(sides) > MAX_NDIM or any(type(s) is not int or not 0 < s <= MAX_SIDE for s in sides):
        raise SpecError(f"{where}: at most {MAX_NDIM} sides of 1 to {MAX_SIDE}")
    return tuple(sides)


def list_of(value: Any, where: str) -> list[Any]:
    """A list that is not too long."""
    if not isinstance(value, list) or len(value) > MAX_NAMES:
        raise SpecError(f"{where}: a list of at most {MAX_NAMES}")
    return value


def shown(value: Any) -> str:
    """A value for an error message, shortened."""
    said = "any" if value is None else repr(value)
    return said if len(said) <= 200 else said[:200] + "…"
