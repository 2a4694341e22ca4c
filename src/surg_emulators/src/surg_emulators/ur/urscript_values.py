"""Values of a URScript program: numbers, texts, lists, poses, and what operators make of them."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from surg_emulators.ur.urscript_syntax import ScriptError

INTEGERS = 2**31
MOST_ELEMENTS = 10_000


class Pose(list[float]):
    """Position [m] and rotation vector [rad]."""


def binary(sign: str, left: Any, right: Any) -> Any:
    """The value of an operation.

    Raises:
        ScriptError: There is none of these values, or it is no integer of the controller.
    """
    if isinstance(left, str) or isinstance(right, str):
        if sign not in ("==", "!="):
            raise ScriptError(f"{sign!r} of a text")
    elif isinstance(left, list) and sign in ("+", "-"):
        return _elementwise(sign, left, right)
    elif sign in ("*", "/") and isinstance(left, list) and _is_number(right):
        return type(left)(_BINARY[sign](each, right) for each in left)
    elif sign == "*" and isinstance(right, list) and _is_number(left):
        return type(right)(left * each for each in right)
    elif sign in ("*", "/", "%") and (isinstance(left, list) or isinstance(right, list)):
        raise ScriptError(f"{str(sign)!r} of {left!r} and {right!r}")
    value = _BINARY[sign](left, right)
    if type(value) is int and not -INTEGERS <= value < INTEGERS:
        raise ScriptError(f"integer {left} {sign} {right} overflows")
    return value


def copy(value: Any) -> Any:
    """The value, with lists of its own.

    Raises:
        ScriptError: It has too many elements.
    """
    if not isinstance(value, list):
        return value
    if _size(value) > MOST_ELEMENTS:
        raise ScriptError(f"a list of more than {MOST_ELEMENTS} elements")
    return type(value)(copy(each) for each in value)


def _size(value: Any) -> int:
    """Elements of a list and of those in it; stops counting when there are too many."""
    count, left = 0, [value]
    while left and count <= MOST_ELEMENTS:
        here = left.pop()
        count += len(here)
        left += [each for each in here if isinstance(each, list)]
    return count


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def list_place(value: Any) -> int:
    """A place in a list, from 0.

    Raises:
        ScriptError: The value is none.
    """
    if isinstance(value, bool) or int(value) != value or value < 0:
        raise ScriptError(f"index {value!r}: not a number from 0")
    return int(value)


def _elementwise(sign: str, left: list[Any], right: list[Any]) -> list[Any]:
    if not isinstance(right, list) or len(left) != len(right):
        raise ScriptError(f"{sign!r} of lists of different lengths")
    return type(left)(_BINARY[sign](a, b) for a, b in zip(left, right, strict=True))


_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
    "and": lambda a, b: bool(a) and bool(b),
    "or": lambda a, b: bool(a) or bool(b),
    "xor": lambda a, b: bool(a) != bool(b),
}
