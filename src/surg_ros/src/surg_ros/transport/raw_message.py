"""A message of every tick as its subscriber keeps it: as bytes, until somebody looks.

Of 500 cycles a second most are only counted: reading each would cost a node more than the rest of
its work. A subscriber gets the bytes by naming a class that is both, such as

    class RawCycle(RawMessage, Cycle): ...

The header stands first: seq, seconds, nanoseconds, length of the frame id, frame id.
"""

from __future__ import annotations

import struct
from typing import TypeVar

Self = TypeVar("Self", bound="RawMessage")


class RawMessage:
    """The part of such a class that keeps the bytes; put it before the message's own class.

    Attributes:
        data: The message, as on the wire.
    """

    def __init__(self) -> None:
        self.data = b""

    def deserialize(self: Self, data: bytes) -> Self:
        """Keep the bytes; rospy calls this."""
        self.data = data
        return self

    def stamp(self) -> float:
        """Stamp of the header [s].

        Raises:
            struct.error: The message is too short.
        """
        seconds, nanoseconds = struct.unpack_from("<2I", self.data, 4)
        return float(seconds) + 1e-9 * float(nanoseconds)

    def tick(self) -> int:
        """The tick, of a message that has it right behind its header (Cycle, TaskState).

        Raises:
            struct.error: The message is too short.
        """
        (frame,) = struct.unpack_from("<I", self.data, 12)
        (tick,) = struct.unpack_from("<Q", self.data, 16 + frame)
        return int(tick)
