"""A ROS image as a frame to encode."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from surg_recording.video import compressed_image

_WIDE = {"mono16": "<u2", "16UC1": "<u2", "32FC1": "<u4"}
"""Encodings whose values have several bytes, and their type."""


class Frame(NamedTuple):
    """One image of a sensor_msgs/Image or CompressedImage (step 0), and its times [ns]."""

    data: bytes
    width: int
    height: int
    step: int
    encoding: str
    stamp_ns: int
    receive_ns: int
    problem: str | None = None


def frame_of(message: Any, stamp_ns: int, receive_ns: int) -> Frame:
    """A sensor_msgs/Image, or the JPEG or PNG picture of a CompressedImage (which has a format)."""
    data, coding = message.data, getattr(message, "format", None)
    if coding is None:
        size = message.width, message.height, message.step
        if message.encoding in _WIDE and message.is_bigendian:
            kind = np.dtype(_WIDE[message.encoding])
            if len(data) % kind.itemsize:
                problem = f"{len(data)} bytes are no whole number of {message.encoding} values"
                return Frame(data, *size, message.encoding, stamp_ns, receive_ns, problem)
            data = np.frombuffer(data, kind).byteswap().tobytes()
        return Frame(data, *size, message.encoding, stamp_ns, receive_ns)
    try:
        coded = compressed_image.read_header(data, coding)
    except ValueError as problem:
        return Frame(data, 0, 0, 0, coding, stamp_ns, receive_ns, str(problem))
    return Frame(data, coded.width, coded.height, 0, coded.encoding, stamp_ns, receive_ns)
