"""Packet of one encoded picture, the same from the encoder's pipe to the browser.

A little-endian header of 48 bytes, then the picture. `page/picture.js` reads it too.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MAGIC = b"SPIC"
_HEADER = struct.Struct("<4sBBBxBBBxHHIqqqI")
HEADER_BYTES = _HEADER.size
LARGEST = 16 << 20
"""[bytes] Largest encoded picture."""
LAYOUTS = ("left", "stereo", "left_half", "stereo_half")
CODECS = ("h264", "jpeg")
WIDEST = 200
"""[ms] What a page that cannot keep up may ask for between two pictures."""


class PacketError(ValueError):
    """Bytes that are not a packet."""


@dataclass(frozen=True)
class Packet:
    """One encoded picture."""

    layout: str  # "left", or "stereo": left and right eye side by side; "_half": of half the size
    codec: str  # "h264" (Annex B) or "jpeg"
    key: bool  # it can be decoded without earlier pictures
    profile: tuple[int, int, int]  # H.264's profile, constraints and level; zeros for JPEG
    width: int  # [px]
    height: int  # [px]
    seq: int  # sequence number within layout and codec
    exposed_us: int  # stamp of the picture, wall clock [µs]
    received_us: int  # receipt by the encoder [µs]
    encoded_us: int  # end of the encoding [µs]
    data: bytes  # the encoded picture

    def pack(self) -> bytes:
        """Header and picture."""
        kind = LAYOUTS.index(self.layout), CODECS.index(self.codec), self.key
        size = self.width, self.height, self.seq & 0xFFFFFFFF
        times = self.exposed_us, self.received_us, self.encoded_us
        head = _HEADER.pack(MAGIC, *kind, *self.profile, *size, *times, len(self.data))
        return head + self.data


def size_of(header: bytes) -> int:
    """Number of bytes that follow a header.

    Raises:
        PacketError: It is not a header.
    """
    return _unpack(header)[-1]


def unpack(data: bytes) -> Packet:
    """A packet from header and picture.

    Raises:
        PacketError: It is not a packet.
    """
    fields = _unpack(data[:HEADER_BYTES])
    _, layout, codec, key, a, b, c, width, height, seq, exposed, received, encoded, size = fields
    picture = data[HEADER_BYTES:]
    if len(picture) != size:
        raise PacketError(f"{len(picture)} bytes follow the header; expected: {size}")
    kind = LAYOUTS[layout], CODECS[codec], bool(key), (a, b, c)
    return Packet(*kind, width, height, seq, exposed, received, encoded, picture)


def _unpack(header: bytes) -> tuple[int, ...]:
    if len(header) != HEADER_BYTES or header[:4] != MAGIC:
        raise PacketError(f"not a picture header: {header[:8]!r}")
    fields = _HEADER.unpack(header)
    if fields[1] >= len(LAYOUTS) or fields[2] >= len(CODECS) or fields[-1] > LARGEST:
        raise PacketError("a picture header of another version")
    return fields
