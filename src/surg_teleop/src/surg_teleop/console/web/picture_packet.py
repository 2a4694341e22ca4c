"""One encoded picture on its way: the same bytes from the encoder's pipe to the browser.

A header of 48 bytes, little-endian, and the encoded picture. `page/picture.js` reads it too.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MAGIC = b"SPIC"
_HEADER = struct.Struct("<4sBBBxBBBxHHIqqqI")
HEADER_BYTES = _HEADER.size
LARGEST = 16 << 20
"""[bytes] of an encoded picture; more is no picture."""
LAYOUTS = ("left", "stereo")
CODECS = ("h264", "jpeg")


class WireError(ValueError):
    """Bytes that are no picture."""


@dataclass(frozen=True)
class Packet:
    """One encoded picture.

    Attributes:
        layout: "left" or "stereo" (left and right eye side by side).
        codec: "h264" (Annex B) or "jpeg".
        key: Whether it can be decoded without the one before.
        profile: H.264's profile, constraints and level; zeros for JPEG.
        width: [px].
        height: [px].
        seq: Counts the pictures of this layout and codec.
        exposed_us: Stamp of the picture, wall clock [µs].
        received_us: When it reached the encoder [µs].
        encoded_us: When it was encoded [µs].
        data: The picture.
    """

    layout: str
    codec: str
    key: bool
    profile: tuple[int, int, int]
    width: int
    height: int
    seq: int
    exposed_us: int
    received_us: int
    encoded_us: int
    data: bytes

    def pack(self) -> bytes:
        """Header and picture."""
        return (
            _HEADER.pack(
                MAGIC,
                LAYOUTS.index(self.layout),
                CODECS.index(self.codec),
                self.key,
                *self.profile,
                self.width,
                self.height,
                self.seq & 0xFFFFFFFF,
                self.exposed_us,
                self.received_us,
                self.encoded_us,
                len(self.data),
            )
            + self.data
        )


def size_of(header: bytes) -> int:
    """Number of bytes that follow a header.

    Raises:
        WireError: It is no header.
    """
    return _unpack(header)[-1]


def unpack(data: bytes) -> Packet:
    """A packet from header and picture.

    Raises:
        WireError: It is none.
    """
    _, layout, codec, key, a, b, c, width, height, seq, exposed, received, encoded, size = _unpack(
        data[:HEADER_BYTES]
    )
    picture = data[HEADER_BYTES:]
    if len(picture) != size:
        raise WireError(f"{len(picture)} bytes follow the header, which says {size}")
    return Packet(
        LAYOUTS[layout],
        CODECS[codec],
        bool(key),
        (a, b, c),
        width,
        height,
        seq,
        exposed,
        received,
        encoded,
        picture,
    )


def _unpack(header: bytes) -> tuple[int, ...]:
    if len(header) != HEADER_BYTES or header[:4] != MAGIC:
        raise WireError(f"no picture header: {header[:8]!r}")
    fields = _HEADER.unpack(header)
    if fields[1] >= len(LAYOUTS) or fields[2] >= len(CODECS) or fields[-1] > LARGEST:
        raise WireError("a picture header of another version")
    return fields
