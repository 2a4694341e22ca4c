"""Decodes messages that were subscribed to without knowing their type."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import roslib.message


class MessageDecoder:
    """Finds the installed class of a ``rospy.AnyMsg``; each class is looked up once."""

    def __init__(self) -> None:
        self._classes: dict[tuple[str, str], Any] = {}

    def class_of(
        self, message: Any, allowed: Sequence[str] | None = None
    ) -> tuple[Any, str | None]:
        """The class of a message, or None and the reason why it cannot be decoded.

        Args:
            message: A ``rospy.AnyMsg``.
            allowed: Types that can be used; None: all.
        """
        header = message._connection_header
        kind, md5 = str(header.get("type", "")), str(header.get("md5sum", ""))
        if (kind, md5) not in self._classes:
            self._classes[kind, md5] = roslib.message.get_message_class(kind)
        installed = self._classes[kind, md5]
        if installed is None:
            return None, f"its type {kind} is not installed here"
        if installed._md5sum != md5:
            return None, f"its sender has another definition of {kind} than this machine"
        if allowed is not None and kind not in allowed:
            return None, f"its type is {kind}; images are {' and '.join(allowed)}"
        return installed, None


def sender(message: Any) -> str:
    """Caller id of the node that sent a message."""
    return str(message._connection_header.get("callerid", ""))
