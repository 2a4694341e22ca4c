"""The kernel's input events: the 24 bytes that an event device hands out per change.

Layout: ``struct input_event`` of <linux/input.h>: two longs of time, then type, code (16 bits each)
and value (32 bits). What a person did comes as a group of events that ends with SYN_REPORT.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

EVENT = struct.Struct("@llHHi")

EV_SYN, EV_KEY, EV_REL, EV_ABS = 0x00, 0x01, 0x02, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3


@dataclass(frozen=True, slots=True)
class Event:
    """One change.

    Attributes:
        kind: EV_SYN, EV_KEY, EV_REL, EV_ABS; others are passed on and mean nothing to us.
        code: Which key or axis.
        value: Key: 0 released, 1 pressed, 2 repeated. Axis: its reading, or its change (EV_REL).
    """

    kind: int
    code: int
    value: int

    def to_bytes(self) -> bytes:
        """As the kernel would write it, at time 0."""
        return EVENT.pack(0, 0, self.kind, self.code, self.value)


REPORT = Event(EV_SYN, SYN_REPORT, 0)
DROPPED = Event(EV_SYN, SYN_DROPPED, 0)


class Decoder:
    """Bytes to groups of events; keeps what is not complete yet.

    A group is what one SYN_REPORT closes: half a diagonal is never shown. After SYN_DROPPED (the
    kernel's buffer ran over) everything up to the next SYN_REPORT is worthless, and what was before
    may be out of date: the device has to be asked for its whole state.
    """

    def __init__(self) -> None:
        self._bytes = b""
        self._group: list[Event] = []
        self._dropping = False

    def feed(self, data: bytes) -> list[list[Event] | None]:
        """Takes what was read.

        Args:
            data: Any number of bytes.

        Returns:
            The complete groups, without their SYN_REPORT; None stands for a loss of events.
        """
        data = self._bytes + data
        whole = len(data) - len(data) % EVENT.size
        self._bytes = data[whole:]
        groups: list[list[Event] | None] = []
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            if kind == EV_SYN and code == SYN_DROPPED:
                self._dropping = True
            elif kind == EV_SYN and code == SYN_REPORT:
                groups.append(None if self._dropping else self._group)
                self._group, self._dropping = [], False
            elif not self._dropping:
                self._group.append(Event(kind, code, value))
        return groups
