"""Decodes messages whose type the subscriber does not know."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import roslib.message

get_message_class = functools.cache(roslib.message.get_message_class)
"""The class of a type that is installed here, else None."""


def class_of(message: Any, allowed: Sequence[str] | None = None) -> tuple[Any, str | None]:
    """The class of a ``rospy.AnyMsg``, or None and the reason why it cannot be decoded.

    ``allowed`` types can be used; None: all.
    """
    header = message._connection_header
    kind = str(header.get("type", ""))
    installed = get_message_class(kind)
    if installed is None:
        return None, f"its type {kind} is not installed here"
    if installed._md5sum != header.get("md5sum"):
        return None, f"its sender has another definition of {kind} than this machine"
    if allowed is not None and kind not in allowed:
        return None, f"its type is {kind}; images are {' and '.join(allowed)}"
    return installed, None


def sender(message: Any) -> str:
    """Caller id of the node that sent a message."""
    return str(message._connection_header.get("callerid", ""))
