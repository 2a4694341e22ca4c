"""What a device's process writes to the capture node: one header line in JSON, then the pixels.

``{"kind": "pictures", "stamp": ns, "received": ns, "eyes": [[width, height], ...], "jpegs":
[bytes, ...]}`` is followed by the eyes' RGB pixels, then the JPEG pictures. ``{"kind": "state",
"code": ..., "text": ...}`` says why there is no picture, or with the code ``open`` that there are.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from surg_perception.capture.picture_source import Image

LONGEST_HEADER = 65536
OPEN = "open"


class FramePipeError(ValueError):
    """The other end wrote something else."""


@dataclass(frozen=True)
class Pictures:
    """The eyes that a device delivered at one time, left first.

    Attributes:
        stamp_ns: In ROS time.
        received_ns: In ROS time.
        eyes: (h, w, 3) RGB.
        jpegs: The same, coded by the device, in its full size; empty: it did not.
    """

    stamp_ns: int
    received_ns: int
    eyes: tuple[Image, ...]
    jpegs: tuple[bytes, ...] = ()


@dataclass(frozen=True)
class DeviceState:
    """Why there is no picture (a code of SourceError or Signal), or ``open``."""

    code: str
    text: str


def write(out: BinaryIO, message: Pictures | DeviceState) -> None:
    """Write a message and flush."""
    if isinstance(message, DeviceState):
        _header(out, {"kind": "state", "code": message.code, "text": message.text})
    else:
        sizes = [[eye.shape[1], eye.shape[0]] for eye in message.eyes]
        lengths = [len(jpeg) for jpeg in message.jpegs]
        header = {"kind": "pictures", "stamp": message.stamp_ns, "received": message.received_ns}
        _header(out, {**header, "eyes": sizes, "jpegs": lengths})
        for eye in message.eyes:
            out.write(np.ascontiguousarray(eye).data)
        for jpeg in message.jpegs:
            out.write(jpeg)
    out.flush()


def _header(out: BinaryIO, content: dict[str, object]) -> None:
    out.write(json.dumps(content).encode() + b"\n")


def read(stream: BinaryIO) -> Pictures | DeviceState | None:
    """The next message; None: the other end has closed.

    Raises:
        FramePipeError: It is no message.
    """
    line = stream.readline(LONGEST_HEADER)
    if not line:
        return None
    try:
        header = json.loads(line)
        if header["kind"] == "state":
            return DeviceState(str(header["code"]), str(header["text"]))
        sizes: Sequence[Sequence[int]] = header["eyes"]
        eyes = tuple(
            np.frombuffer(_exactly(stream, 3 * w * h), np.uint8).reshape(h, w, 3) for w, h in sizes
        )
        jpegs = tuple(_exactly(stream, length) for length in header["jpegs"])
        return Pictures(int(header["stamp"]), int(header["received"]), eyes, jpegs)
    except EOFError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise FramePipeError(f"no message of a device: {line[:80]!r} ({error})") from error


def _exactly(stream: BinaryIO, length: int) -> bytes:
    data = stream.read(length)
    if len(data) != length:
        raise EOFError
    return data
