"""Joints of a message in the order of an arm's own list."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def positions_of(message: Any, names: Sequence[str]) -> list[float]:
    """Positions of a sensor_msgs/JointState by name.

    Where the message lacks a name, they come as it has them: a sender may leave the names out. The
    caller checks their number.
    """
    where = dict(zip(message.name, message.position, strict=False))
    known = names and set(names) <= set(where)
    return [where[name] for name in names] if known else list(message.position)
