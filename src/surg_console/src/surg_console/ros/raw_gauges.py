"""Reads single values from serialized messages, of which no bytes mean that there is none.

Cheaper than decoding them whole: the page shows 20 values per second of topics at 500 Hz.
"""

from __future__ import annotations

import math
import struct

import surg_core
from surg_core.contract import STATE_NAMES

REASONS = {int(reason): reason for reason in surg_core.Reason.__members__.values()}


def state_and_reason(data: bytes) -> tuple[str, surg_core.Reason | None]:
    """Operating state and reason of a surg_msgs/Cycle; empty and None: unknown."""
    try:  # header with its frame, tick, state, homed, busy, reason_code
        (frame,) = struct.unpack_from("<I", data, 12)
        state, _, _, reason = struct.unpack_from("<4B", data, 24 + frame)
    except struct.error:
        return "", None
    return dict(enumerate(STATE_NAMES)).get(state, ""), REASONS.get(reason)


def last_double(data: bytes) -> float | None:
    """Value of a surg_msgs/ScalarStamped, its last field; None: unknown."""
    if len(data) < 8:
        return None
    return float(struct.unpack_from("<d", data, len(data) - 8)[0])


def depth(data: bytes) -> float | None:
    """Insertion [m]: third of the virtual joints of a sensor_msgs/JointState; None: unknown."""
    try:  # header with its frame, names, positions; each with its length in front
        (frame,) = struct.unpack_from("<I", data, 12)
        (names,) = struct.unpack_from("<I", data, 16 + frame)
        at = 20 + frame
        for _ in range(names):
            (length,) = struct.unpack_from("<I", data, at)
            at += 4 + length
        (count,) = struct.unpack_from("<I", data, at)
        return float(struct.unpack_from("<4d", data, at + 4)[2]) if count == 4 else None
    except struct.error:
        return None


def force(data: bytes) -> float | None:
    """Magnitude of the force of a geometry_msgs/WrenchStamped [N]; None: unknown."""
    try:  # header with its frame, then the force
        (frame,) = struct.unpack_from("<I", data, 12)
        x, y, z = struct.unpack_from("<3d", data, 16 + frame)
    except struct.error:
        return None
    return math.hypot(x, y, z)
