"""Converts messages to CSV rows, without ROS: a message is any object with these members.

A row is a tuple in the order of ``table_columns``; ``None`` becomes an empty field.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from itertools import groupby
from operator import attrgetter
from typing import Any

from surg_core.contract import SECOND_NS
from surg_recording.episode import table_columns
from surg_recording.episode.table_columns import Field, Fields

Row = tuple[Any, ...]
Read = Callable[[Any], Any]
"""The values of a field's columns, of a message."""


def nanoseconds(stamp: Any) -> int:
    """A ROS time as integer nanoseconds."""
    return int(stamp.secs) * SECOND_NS + int(stamp.nsecs)


def _reader(field: Field) -> Read:
    """Reads one field."""
    value = attrgetter(field.source)
    if field.members:
        members = attrgetter(*field.members)
        return lambda message: members(value(message))
    if field.is_array:
        return value  # type: ignore[no-any-return]
    if field.truth_value:
        return lambda message: (int(value(message)),)
    if field.optional:
        return lambda message: (_finite(value(message)),)
    return lambda message: (value(message),)


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _readers(fields: Fields) -> tuple[Read, ...]:
    """Readers of a table's fields; consecutive scalars are read at once, for 500 Hz."""
    readers: list[Read] = []
    for is_scalar, run in groupby((f for f in fields if f.source), key=lambda f: f.is_scalar):
        group = list(run)
        if is_scalar and len(group) > 1:
            readers.append(attrgetter(*(field.source for field in group)))
        else:
            readers += map(_reader, group)
    return tuple(readers)


def _row(head: tuple[Any, ...], readers: tuple[Read, ...], message: Any) -> list[Any]:
    row = list(head)
    for read in readers:
        row.extend(read(message))
    return row


_CYCLE = _readers(table_columns.CYCLE)
_WRIST = _readers(table_columns.WRIST)
_ARM_TRUTH = _readers(table_columns.ARM_TRUTH)
_FORCE = _readers(table_columns.FORCE)
_TASK_STATE = _readers(table_columns.TASK_STATE)
_CLOCK = _readers(table_columns.CLOCK)
_COMMAND = {
    key: [(table_columns.COMMAND.index(each.columns[0]), each, _reader(each)) for each in fields]
    for key, fields in table_columns.COMMAND_FIELDS.items()
}


def cycle(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/Cycle as a row of ``table_columns.cycle``."""
    row = _row((nanoseconds(message.header.stamp), receive_ns), _CYCLE, message)
    return tuple(_row(tuple(row), _WRIST, message) if len(message.wrist) else row)


def ground_truth(stamp_ns: int, tick: int, arm: Any, receive_ns: int) -> Row:
    """One surg_msgs/ArmTruth as a row of ``table_columns.GROUND_TRUTH``."""
    return tuple(_row((stamp_ns, receive_ns, tick), _ARM_TRUTH, arm))


def force(message: Any, receive_ns: int, stamp_ns: int) -> Row:
    """One geometry_msgs/WrenchStamped as a row of ``table_columns.MEASURED_FORCE``.

    A force that is not known (its stamp is 0) or no number is left out; the row has ``stamp_ns``.
    """
    stamp = nanoseconds(message.header.stamp)
    row = _row((stamp, receive_ns, 1), _FORCE, message)
    if stamp > 0 and all(map(math.isfinite, row[3:])):
        return tuple(row)
    return (stamp_ns, receive_ns, 0, None, None, None)


def task_state(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/TaskState as a row of ``table_columns.task``."""
    head = (nanoseconds(message.header.stamp), receive_ns)
    return (*_row(head, _TASK_STATE, message), *message.values)


def clock_sync(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/ClockSync as a row of ``table_columns.CLOCK_SYNC``."""
    return tuple(_row((nanoseconds(message.header.stamp), receive_ns), _CLOCK, message))


def command(topic: str, message: Any, source: str, receive_ns: int) -> Row:
    """A motion command as a row of ``table_columns.COMMAND``, as far as the message goes.

    ``topic`` below the arm (``servo_cp``, ``jaw/servo_jp``) tells the type: ``_cp`` PoseStamped,
    ``_cv`` TwistStamped, ``_jp``, ``_jr`` and ``_jv`` JointState.
    """
    row: list[Any] = [None] * len(table_columns.COMMAND)
    row[:4] = nanoseconds(message.header.stamp), receive_ns, topic, source
    key = "jaw/" if topic.startswith("jaw/") else topic[-3:]
    for start, field, read in _COMMAND.get(key, ()):
        size = len(field.columns)
        row[start : start + size] = [*read(message), *[None] * size][:size]
    return tuple(row)


def operating_state(message: Any) -> str:
    """A crtk_msgs/OperatingState as the text of an event."""
    return json.dumps(
        {
            "state": message.state,
            "is_homed": bool(message.is_homed),
            "is_busy": bool(message.is_busy),
        }
    )
