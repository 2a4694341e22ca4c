"""Message classes whose subscriber gets the bytes, for the ``unpack`` functions."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState


class _Bytes:
    """Put before a message class: keeps the bytes for the ``unpack`` functions."""

    data = b""

    def deserialize(self, data: bytes) -> Any:
        """Called by rospy."""
        self.data = data
        return self


class JointStateBytes(_Bytes, JointState):
    """A JointState as on the wire."""


class TwistBytes(_Bytes, TwistStamped):
    """A TwistStamped as on the wire."""
