"""Frames of Dynamixel protocol 2.0: CRC, byte stuffing, and a parser that survives any noise.

A frame is ``FF FF FD 00 ID LENGTH INSTRUCTION PARAMETERS CRC``; length and CRC have two bytes, the
lower one first. Behind each ``FF FF FD`` in instruction and parameters stands one more ``FD``.
"""

from __future__ import annotations

from dataclasses import dataclass

HEADER = b"\xff\xff\xfd\x00"
STATUS = 0x55
_MARK, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_HEAD = 7
"""Bytes in front of the instruction."""
LONGEST = 1024
"""Bytes of a frame; a longer one is noise."""


@dataclass(frozen=True)
class Frame:
    """One frame without its stuffing."""

    id: int
    instruction: int
    parameters: bytes


def _of_byte(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1
    return crc & 0xFFFF


_CRC = [_of_byte(byte) for byte in range(256)]


def crc16(data: bytes) -> int:
    """CRC with the polynomial 0x8005, from 0."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC[(crc >> 8) ^ byte]
    return crc


def encode(frame: Frame) -> bytes:
    """The bytes of a frame."""
    body = (bytes([frame.instruction]) + frame.parameters).replace(_MARK, _STUFFED)
    head = HEADER + bytes([frame.id]) + (len(body) + 2).to_bytes(2, "little")
    return head + body + crc16(head + body).to_bytes(2, "little")


def status(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """The bytes of a servo's answer."""
    return encode(Frame(servo_id, STATUS, bytes([error]) + parameters))


class FrameParser:
    """Finds frames in a stream of bytes."""

    def __init__(self) -> None:
        self._held = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes; returns the frames that they complete."""
        self._held += data
        found = []
        while (frame := self._next()) is not None:
            found.append(frame)
        return found

    def pause(self) -> list[Frame]:
        """The line has been quiet: what looked like the beginning of a frame was none."""
        found = []
        while self._held:
            self._held = self._held[1:]
            found += self.feed(b"")
        return found

    def _next(self) -> Frame | None:
        while True:
            start = self._held.find(HEADER)
            if start < 0:
                self._held = self._held[-(len(HEADER) - 1) :]
                return None
            self._held = self._held[start:]
            if len(self._held) < _HEAD:
                return None
            length = int.from_bytes(self._held[5:_HEAD], "little")
            if 3 <= length <= LONGEST:
                whole = self._held[: _HEAD + length]
                if len(whole) < _HEAD + length:
                    return None
                if crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little"):
                    self._held = self._held[len(whole) :]
                    body = whole[_HEAD:-2].replace(_STUFFED, _MARK)
                    return Frame(whole[4], body[0], body[1:])
            self._held = self._held[1:]
