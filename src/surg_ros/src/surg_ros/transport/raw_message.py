"""Messages that stay bytes until somebody reads them.

Of 500 cycles per second most are only counted. Parsing each of them would cost a node more than
all its other work. A subscriber gets the bytes by naming a class that is both:

    class RawCycle(RawMessage, Cycle): ...

Off (`switches`): rospy parses every message on receipt, as it does for any other class.
"""

from __future__ import annotations

import struct
from typing import Any, TypeVar

from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState

from surg_msgs.msg import Cycle, TaskState
from surg_ros.transport import switches

Self = TypeVar("Self", bound="RawMessage")
_PARSE = switches.plain("raw_message")


class RawMessage:
    """The part of such a class that keeps the bytes; put it before the message class.

    Attributes:
        data: The message as on the wire.
    """

    def __init__(self) -> None:
        self.data = b""

    def deserialize(self: Self, data: bytes) -> Self:
        """Keep the bytes; rospy calls this."""
        self.data = data
        if _PARSE:
            self.read()
        return self

    def read(self) -> Any:
        """The message, parsed.

        Raises:
            genpy.DeserializationError: The bytes are not such a message.
        """
        kind: Any = type(self).__mro__[2]  # of (RawCycle, RawMessage, Cycle, …)
        return kind().deserialize(self.data)

    def stamp(self) -> float:
        """Stamp of the header [s].

        Raises:
            struct.error: The message is too short.
        """
        seconds, nanoseconds = struct.unpack_from("<2I", self.data, 4)
        return float(seconds) + 1e-9 * float(nanoseconds)

    def tick(self) -> int:
        """The tick of a message that has it right behind its header (Cycle, TaskState).

        Raises:
            struct.error: The message is too short.
        """
        (frame,) = struct.unpack_from("<I", self.data, 12)
        (tick,) = struct.unpack_from("<Q", self.data, 16 + frame)
        return int(tick)


class RawCycle(RawMessage, Cycle):
    """A Cycle that keeps its bytes."""


class RawTaskState(RawMessage, TaskState):
    """A TaskState that keeps its bytes."""


class RawJointState(RawMessage, JointState):
    """A JointState that keeps its bytes."""


class RawTwist(RawMessage, TwistStamped):
    """A TwistStamped that keeps its bytes."""
