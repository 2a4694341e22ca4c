"""Parameters of a node: declared as a dataclass, checked once, then frozen. No ROS.

::

    @dataclass(frozen=True)
    class Settings:
        cell: str = text()                         # must be given
        mode: str = one_of(("lockstep", "freerun"), default="lockstep")
        rate: float = real(20.0, 500.0, default=100.0)

    settings = read(Settings, rospy.get_param("~", {}))

Whatever must not be used is a :class:`ParamError`: which parameter, its value, what is allowed.
Rules between parameters stand in ``__post_init__`` and raise the same error.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

Kind = TypeVar("Kind")
_KEY = "surg_ros.params"


class ParamError(ValueError):
    """A parameter that must not be used; ``value`` as given, None: it is missing."""

    def __init__(self, name: str, value: object, allowed: str, problem: str = "") -> None:
        stated = problem or ("is missing" if value is None else f"is {value!r}")
        super().__init__(f"parameter ~{name} {stated}; allowed: {allowed}")
        self.name, self.value, self.allowed = name, value, allowed


@dataclass(frozen=True)
class _Check:
    convert: Callable[[Any], Any]  # raises ValueError for what is not allowed
    allowed: str


def read(kind: type[Kind], given: Mapping[str, Any]) -> Kind:
    """The parameters of a node.

    Args:
        kind: A dataclass whose fields are declared by this module's functions.
        given: Values by name without ``~``, as ``rospy.get_param("~", {})`` returns them.
            Namespaces below the node's are ignored.

    Raises:
        ParamError: A parameter is unknown, missing or out of range.
    """
    declared: dict[str, _Check] = {
        each.name: each.metadata[_KEY]
        for each in fields(kind)  # type: ignore[arg-type]
        if _KEY in each.metadata
    }
    for name, value in given.items():
        if name not in declared and not isinstance(value, dict):
            known = ", ".join(f"~{each}" for each in declared)
            raise ParamError(name, value, known, "is unknown")
    values = {
        name: _converted(name, check, given[name])
        for name, check in declared.items()
        if name in given
    }
    for each in fields(kind):  # type: ignore[arg-type]
        required = each.default is MISSING and each.default_factory is MISSING
        if each.name in declared and required and each.name not in values:
            raise ParamError(each.name, None, declared[each.name].allowed)
    return kind(**values)


def text(
    default: Any = MISSING, *, empty: bool = False, longest: int | None = None, allowed: str = ""
) -> Any:
    """A text of at most ``longest`` characters; ``allowed`` says in the error what it is."""

    def good(value: Any) -> bool:
        short = longest is None or len(str(value)) <= longest
        return isinstance(value, str | Path) and bool(str(value) or empty) and short

    size = "" if longest is None else f" of at most {longest} characters"
    allowed = allowed or f"a {'' if empty else 'non-empty '}text{size}"
    return _declare(_checked(str, good), allowed, default)


def one_of(options: tuple[str, ...], default: Any = MISSING) -> Any:
    """One of some words."""
    return _declare(_checked(str, lambda value: value in options), ", ".join(options), default)


def flag(default: Any = MISSING) -> Any:
    """True or false."""
    check = _checked(bool, lambda value: isinstance(value, bool))
    return _declare(check, "true or false", default)


def whole(low: int, high: int, default: Any = MISSING) -> Any:
    """A whole number from low to high."""
    check = _checked(int, lambda v: _is_number(v) and v == int(v) and low <= v <= high)
    return _declare(check, f"a whole number from {low} to {high}", default)


def real(low: float = -math.inf, high: float = math.inf, default: Any = MISSING) -> Any:
    """A finite number from low to high."""
    check = _checked(float, lambda v: _is_number(v) and low <= v <= high and math.isfinite(v))
    bounds = {(True, True): f" from {low:g} to {high:g}", (True, False): f" from {low:g}"}
    number = f"a number{bounds.get((low > -math.inf, high < math.inf), '')}"
    return _declare(check, number, default)


def vector(size: int, default: Any = MISSING, *, meaning: str = "") -> Any:
    """Some finite numbers, not all zero; ``meaning`` names them for the error."""

    def convert(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or any(isinstance(v, bool | str) for v in value):
            raise ValueError
        numbers = tuple(float(each) for each in value)
        if len(numbers) != size or not all(map(math.isfinite, numbers)) or not any(numbers):
            raise ValueError
        return numbers

    return _declare(convert, f"{size} numbers{meaning and ': '}{meaning}", default)


def names(
    default: Any = MISSING,
    *,
    options: tuple[str, ...] | None = None,
    most: int | None = None,
    least: int = 0,
) -> Any:
    """Names, each once: a list, or one string such as ``a,b`` (what a rosrun line can pass)."""

    def convert(value: Any) -> tuple[str, ...]:
        items = _items(value) if isinstance(value, str) else value
        if not isinstance(items, list | tuple) or not all(isinstance(each, str) for each in items):
            raise ValueError
        chosen = tuple(each for each in (item.strip(" '\"") for item in items) if each)
        if len(set(chosen)) != len(chosen) or not least <= len(chosen) <= (most or len(chosen)):
            raise ValueError
        if options is not None and not set(chosen) <= set(options):
            raise ValueError
        return chosen

    size = f"at least {least} " if least else f"at most {most} " if most is not None else ""
    choice = f" of {', '.join(options)}" if options else ""
    return _declare(convert, f"{size}names{choice}, each once: a list, or 'a,b'", default)


def _items(value: str) -> list[str]:
    """The parts of ``a,b`` or ``[a, b]``; a pattern such as ``/PSM[12]`` keeps its bracket."""
    whole = value.startswith("[") and value.endswith("]")
    return (value[1:-1] if whole else value).split(",")


def dictionary() -> Any:
    """A dictionary, or one as JSON; empty by default."""

    def convert(value: Any) -> dict[str, Any]:
        parsed = json.loads(value) if isinstance(value, str) and value else value or {}
        if not isinstance(parsed, dict):
            raise ValueError
        return parsed

    return _declare(convert, "a dictionary, or a JSON object", MISSING, dict)


def path(default: Any = MISSING) -> Any:
    """A path, made absolute; None as the default: an empty text stands for none."""

    def convert(value: Any) -> Path | None:
        if not isinstance(value, str | Path) or not (value or default is None):
            raise ValueError
        return Path(value).resolve() if value else None

    return _declare(convert, "a path", default)


def _checked(kind: Callable[[Any], Any], good: Callable[[Any], bool]) -> Callable[[Any], Any]:
    """A conversion that refuses what is not good."""

    def convert(value: Any) -> Any:
        if not good(value):
            raise ValueError
        return kind(value)

    return convert


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _declare(
    convert: Callable[[Any], Any], allowed: str, default: Any, factory: Any = MISSING
) -> Any:
    options = {"default": default} if factory is MISSING else {"default_factory": factory}
    if options.get("default", 0) is MISSING:
        options = {}
    return field(kw_only=True, metadata={_KEY: _Check(convert, allowed)}, **options)


def _converted(name: str, check: _Check, value: Any) -> Any:
    try:
        return check.convert(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise ParamError(name, value, check.allowed) from error
