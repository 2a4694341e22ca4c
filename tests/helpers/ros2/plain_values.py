"""A ROS 1 message as the plain values that rclpy's scripts print."""

from __future__ import annotations

from typing import Any


def values(message: Any) -> Any:
    """Without the header's number; times and bytes as ROS 2 has them."""
    if hasattr(message, "secs"):
        return {"sec": message.secs, "nanosec": message.nsecs}
    if hasattr(message, "__slots__"):
        names = [n for n in message.__slots__ if (n, message._type) != ("seq", "std_msgs/Header")]
        level = {"level"} if message._type == "diagnostic_msgs/DiagnosticStatus" else set()
        return {
            n.lower(): getattr(message, n) % 256 if n in level else values(getattr(message, n))
            for n in names
        }
    if isinstance(message, list | tuple):
        return [values(each) for each in message]
    return list(message) if isinstance(message, bytes) else message
