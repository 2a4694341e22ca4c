"""The one check of a status message before anybody decides by it.

A receiver fails closed: a status that is missing, old, of another version or with an enumeration
value that its definition does not name must be read as *no*. A message describes itself (version,
constants, types), so this module needs no ROS.
"""

from __future__ import annotations

import functools
import math
from typing import Any

SILENCE = 2.0
"""[s] A sender whose last status is older is absent. Statuses are sent at 2 Hz or more often."""
REPEAT = 10.0
"""[s] The same problem is reported no more often."""


def fault(message: Any) -> str:
    """Why a status message must not be acted on.

    Args:
        message: A message with `version`, `VERSION` and a header. A field with constants named
            after it (``state`` and ``STATE_...``) is an enumeration; messages inside are checked
            too.

    Returns:
        The field and what is wrong with it; empty: nothing.
    """
    if message.version != message.VERSION:
        return f"version is {message.version}; this receiver knows {message.VERSION}"
    if message.header.stamp.to_nsec() == 0:
        return "header.stamp is 0"
    return _unknown_value(message, "")


def value_name(message: Any, field: str) -> str:
    """The name of an enumeration field's value without its prefix, such as ``FOLLOWING``.

    Args:
        message: The message.
        field: Such as ``state``.

    Returns:
        The name; empty: the definition names no such value.
    """
    return values(message, field).get(getattr(message, field), "")


def values(message: Any, field: str) -> dict[int, str]:
    """The values of an enumeration field by number; empty: the field is none.

    Args:
        message: A message or its class.
        field: Such as ``state``.
    """
    return _values(message if isinstance(message, type) else type(message), field)


@functools.cache
def _values(kind: type, field: str) -> dict[int, str]:
    """See `values`. Looking through a class takes 0.1 ms; nodes would do so 100 times a second."""
    prefix = f"{field.upper()}_"
    return {
        getattr(kind, name): name.removeprefix(prefix)
        for name in dir(kind)
        if name.startswith(prefix)
    }


def _unknown_value(message: Any, path: str) -> str:
    for field in message.__slots__:
        content = getattr(message, field)
        known = values(message, field)
        if known and content not in known:
            return f"{path}{field} is {content}; known are {sorted(known)}"
        parts = content if isinstance(content, list | tuple) else [content]
        for part in parts:
            if hasattr(part, "_slot_types") and (found := _unknown_value(part, f"{path}{field}.")):
                return found
    return ""


class LatestStatus:
    """The newest status on one topic, as far as it may be acted on.

    Args:
        topic: Its name, for the problem's text.
        silence: Older ones do not count [s].
    """

    def __init__(self, topic: str, silence: float = SILENCE) -> None:
        self._topic, self._silence = topic, silence
        self._message: Any = None
        self._fault = ""
        self._received = -math.inf
        self._reported = ("", -math.inf)

    @property
    def heard(self) -> bool:
        """Whether any message has come, valid or not."""
        return self._message is not None

    @property
    def valid(self) -> Any:
        """The newest message, however old; None: there is none, or it is invalid."""
        return None if self._fault else self._message

    def take(self, message: Any, now: float) -> None:
        """A message has come.

        Args:
            message: What came.
            now: The receiver's steady clock [s].
        """
        self._message, self._received, self._fault = message, now, fault(message)

    def at(self, now: float) -> Any:
        """The newest message; None: there is none that may be acted on (`problem`).

        Args:
            now: The receiver's steady clock [s].
        """
        return None if self.problem(now) else self._message

    def problem(self, now: float) -> str:
        """The topic and why its status may not be acted on; empty: it may.

        Args:
            now: The receiver's steady clock [s].
        """
        if self._message is None:
            return f"{self._topic}: no message yet"
        if self._fault:
            return f"{self._topic}: {self._fault}"
        if not 0.0 <= now - self._received <= self._silence:
            return f"{self._topic}: no message for more than {self._silence:g} s"
        return ""

    def complaint(self, now: float) -> str:
        """The problem for a log: once when it appears or changes, then every `REPEAT` seconds.

        Args:
            now: The receiver's steady clock [s].
        """
        problem, (before, at) = self.problem(now), self._reported
        if not problem:
            self._reported = ("", -math.inf)
        elif problem != before or now - at >= REPEAT:
            self._reported = (problem, now)
            return problem
        return ""
