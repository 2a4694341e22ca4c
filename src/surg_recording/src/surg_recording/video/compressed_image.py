"""Reads the header of a JPEG or PNG picture, without decoding it.

A recorder must know the size of a picture before it passes it on, and must not pass on a truncated
one: decoders fill what is missing with grey and report nothing. Source: ITU-T T.81 (markers),
ISO/IEC 15948 (``IHDR``, ``IEND``).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

JPEG, PNG = "jpeg", "png"
"""Encodings of the pictures of a sensor_msgs/CompressedImage that are recorded."""

_PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
_START, _SCAN, _END = 0xD8, 0xDA, b"\xff\xd9"
_NO_LENGTH = frozenset((0x01, *range(0xD0, 0xD9)))
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers that begin a frame and state its size; the three are tables."""

MAX_PIXELS = 1 << 26
"""Limit on the memory for decoding: a head can announce any size (8192 x 8192)."""


class Coded(NamedTuple):
    """A picture as its header describes it."""

    encoding: str
    width: int
    height: int


def read_header(data: bytes, stated: str = "", most_bits: int = 8) -> Coded:
    """Kind and size of a picture.

    Args:
        data: Its bytes.
        stated: The sender's ``format``, for the error.
        most_bits: Of a colour of a PNG picture.

    Raises:
        ValueError: It is neither JPEG nor PNG, it is truncated, or its pixels cannot be recorded.
    """
    if data[:2] == bytes((0xFF, _START)):
        picture = Coded(JPEG, *_jpeg(data))
    elif data.startswith(_PNG_BEGIN):
        picture = Coded(PNG, *_png(data, most_bits))
    else:
        raise ValueError(f"neither JPEG nor PNG (its sender calls it {stated!r})")
    if picture.width * picture.height > MAX_PIXELS:
        raise ValueError(
            f"{picture.width}x{picture.height} pixels; at most {MAX_PIXELS} are decoded"
        )
    return picture


def _jpeg(data: bytes) -> tuple[int, int]:
    size, place = None, 2
    while place + 4 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF or marker in _NO_LENGTH:
            place += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", data, place + 2)
        if marker in _FRAMES:
            size = _jpeg_size(data, place)
        if marker == _SCAN:
            # Within a scan this pair of bytes cannot occur: it ends the picture, padded or not.
            if size is None or data.rfind(_END, place + 2 + length) < 0:
                break
            return size
        place += 2 + length
    raise ValueError(f"a JPEG picture that is cut or broken ({len(data)} bytes)")


def _jpeg_size(data: bytes, place: int) -> tuple[int, int] | None:
    if place + 9 > len(data):
        return None
    bits, height, width = struct.unpack_from(">BHH", data, place + 4)
    if bits != 8:
        raise ValueError(f"a JPEG picture of {bits} bits per colour; 8 are recorded")
    return (width, height) if width and height else None


def _png(data: bytes, most_bits: int) -> tuple[int, int]:
    if data[12:16] != b"IHDR" or data.rfind(_PNG_END) < 0:
        raise ValueError(f"a PNG picture that is cut or broken ({len(data)} bytes)")
    width, height, bits = struct.unpack_from(">IIB", data, 16)
    if bits > most_bits:
        raise ValueError(f"a PNG picture of {bits} bits per colour; 8 are recorded")
    return width, height
