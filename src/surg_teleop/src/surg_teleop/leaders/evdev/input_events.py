"""The kernel's input events, 24 bytes each.

Layout: ``struct input_event`` of <linux/input.h>: two longs of time, then type, code (16 bits each)
and value (32 bits). Simultaneous changes form a group that ends with SYN_REPORT.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

EVENT = struct.Struct("@llHHi")

EV_SYN, EV_KEY, EV_REL, EV_ABS = 0x00, 0x01, 0x02, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3


@dataclass(frozen=True, slots=True)
class Event:
    """One change."""

    kind: int  # EV_SYN, EV_KEY, EV_REL, EV_ABS; others are ignored
    code: int  # key or axis
    value: int  # key: 0 released, 1 pressed, 2 repeated. Axis: its reading, or its change (EV_REL)


class Decoder:
    """Decodes bytes to complete groups of events.

    A SYN_REPORT closes a group. After SYN_DROPPED (overflow of the kernel's buffer) all events up
    to the next SYN_REPORT are discarded, and the device must be asked for its whole state.
    """

    def __init__(self) -> None:
        self._bytes = b""
        self._group: list[Event] = []
        self._dropping = False

    def feed(self, data: bytes) -> list[list[Event] | None]:
        """Complete groups of events, without SYN_REPORT; None stands for a loss of events."""
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
