"""Writes and reads MCAP files: ROS 1 messages in indexed chunks, for Foxglove, Rerun and mcap.

Needs no package. Format: https://mcap.dev/spec (version 0). Chunks are not compressed: nearly all
bytes are JPEG pictures. All integers are little-endian.
"""

from __future__ import annotations

import dataclasses
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from surg_recording.recording_errors import EpisodeError

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(11, 16)
CHUNK_BYTES = 1 << 20
"""A chunk is closed when its records reach this size."""


@dataclasses.dataclass
class _Chunk:
    """A chunk under construction."""

    records: bytearray = dataclasses.field(default_factory=bytearray)
    index: dict[int, list[tuple[int, int]]] = dataclasses.field(default_factory=dict)
    """Channel → log time and place of each of its messages."""
    begin: int = 0
    end: int = 0


class McapWriter:
    """Writes one file; messages are given in the order of their time."""

    def __init__(self, file: IO[bytes], metadata: dict[str, str]) -> None:
        self._file, self._at = file, 0
        self._schemas: dict[str, bytes] = {}
        self._channels: dict[str, tuple[int, bytes]] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[bytes] = []
        self._begin, self._end = 0, 0
        self._chunk = _Chunk()
        self._put(MAGIC)
        self._record(HEADER, _text("ros1") + _text("surg_recording"))
        place, length = self._at, self._record(METADATA, _text("recording") + _map(metadata))
        self._metadata = struct.pack("<QQ", place, length) + _text("recording")

    def write(self, topic: str, kind: str, definition: str, data: bytes, time_ns: int) -> None:
        """Add a serialised message of a ROS type with its full definition."""
        if topic not in self._channels:
            self._open(topic, kind, definition)
        channel = self._channels[topic][0]
        sequence = self._counts[channel]
        chunk = self._chunk
        if not chunk.index:
            chunk.begin = chunk.end = time_ns
        chunk.begin, chunk.end = min(chunk.begin, time_ns), max(chunk.end, time_ns)
        chunk.index.setdefault(channel, []).append((time_ns, len(chunk.records)))
        head = struct.pack("<HIQQ", channel, sequence, time_ns, time_ns)
        chunk.records += _framed(MESSAGE, head + data)
        self._counts[channel] += 1
        if len(chunk.records) >= CHUNK_BYTES:
            self._close_chunk()

    def close(self) -> None:
        """Write the rest and the summary."""
        self._close_chunk()
        self._record(DATA_END, struct.pack("<I", 0))
        summary, groups = self._at, []
        schemas, channels = list(self._schemas.values()), [c for _, c in self._channels.values()]
        for opcode, records in (
            (SCHEMA, schemas),
            (CHANNEL, channels),
            (STATISTICS, [self._statistics()]),
            (METADATA_INDEX, [self._metadata]),
            (CHUNK_INDEX, self._chunks),
        ):
            if not records:
                continue
            begin = self._at
            for record in records:
                self._record(opcode, record)
            groups.append(struct.pack("<BQQ", opcode, begin, self._at - begin))
        offsets = self._at
        for group in groups:
            self._record(SUMMARY_OFFSET, group)
        self._record(FOOTER, struct.pack("<QQI", summary, offsets, 0))
        self._put(MAGIC)

    def _open(self, topic: str, kind: str, definition: str) -> None:
        """A new channel, with its schema if that is new; both also stand in the chunk."""
        if kind not in self._schemas:
            number = len(self._schemas) + 1
            text = definition.encode()
            schema = struct.pack("<H", number) + _text(kind) + _text("ros1msg") + _block(text)
            self._schemas[kind] = schema
            self._chunk.records += _framed(SCHEMA, schema)
        number = len(self._channels)
        schema_number = list(self._schemas).index(kind) + 1
        channel = struct.pack("<HH", number, schema_number) + _text(topic) + _text("ros1")
        channel += _map({})
        self._channels[topic] = (number, channel)
        self._counts[number] = 0
        self._chunk.records += _framed(CHANNEL, channel)

    def _close_chunk(self) -> None:
        chunk, self._chunk = self._chunk, _Chunk()
        if not chunk.index:
            return
        records = bytes(chunk.records)
        size = len(records)
        head = struct.pack("<QQQI", chunk.begin, chunk.end, size, zlib.crc32(records))
        place = self._at
        length = self._record(CHUNK, head + _text("") + struct.pack("<Q", size) + records)
        indices, begin = {}, self._at
        for channel, entries in chunk.index.items():
            indices[channel] = self._at
            packed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            self._record(MESSAGE_INDEX, struct.pack("<H", channel) + _block(packed))
        offsets = _block(b"".join(struct.pack("<HQ", *item) for item in indices.items()))
        entry = struct.pack("<QQQQ", chunk.begin, chunk.end, place, length) + offsets
        entry += struct.pack("<Q", self._at - begin) + _text("") + struct.pack("<QQ", size, size)
        self._begin = min(self._begin, chunk.begin) if self._chunks else chunk.begin
        self._end = max(self._end, chunk.end)
        self._chunks.append(entry)

    def _statistics(self) -> bytes:
        numbers = (sum(self._counts.values()), len(self._schemas), len(self._channels), 0, 1)
        head = struct.pack("<QHIIII", *numbers, len(self._chunks))
        counts = _block(b"".join(struct.pack("<HQ", *item) for item in self._counts.items()))
        return head + struct.pack("<QQ", self._begin, self._end) + counts

    def _record(self, opcode: int, content: bytes) -> int:
        """Write a record; returns its length."""
        framed = _framed(opcode, content)
        self._put(framed)
        return len(framed)

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)


def messages(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    """Topic, type, time [ns] and data of every message of a file that ``McapWriter`` wrote.

    Raises:
        EpisodeError: It is truncated, or a chunk has another checksum.
    """
    kinds: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    with open(path, "rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise EpisodeError(f"{path}: not an MCAP file")
        for opcode, content in _records(path, file):
            if opcode == DATA_END:
                return
            if opcode != CHUNK:
                continue
            for inner, record in _records(path, _Bytes(_unpacked(path, content))):
                if inner == SCHEMA:
                    kinds[struct.unpack_from("<H", record)[0]] = _text_at(record, 2)[0]
                elif inner == CHANNEL:
                    number, schema = struct.unpack_from("<HH", record)
                    channels[number] = (_text_at(record, 4)[0], kinds[schema])
                elif inner == MESSAGE:
                    number, _, time_ns, _ = struct.unpack_from("<HIQQ", record)
                    yield (*channels[number], time_ns, record[22:])
    raise EpisodeError(f"{path}: ends before its summary; it was cut")


class _Bytes:
    """Reads from bytes as from a file."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def read(self, size: int) -> bytes:
        self._at += size
        return self._data[self._at - size : self._at]


def _records(path: Path, file: Any) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of the records from here on."""
    while head := file.read(9):
        if len(head) < 9 or head.startswith(MAGIC):
            return
        opcode, length = struct.unpack("<BQ", head)
        content = file.read(length)
        if len(content) < length:
            raise EpisodeError(f"{path}: ends within a record; it was cut")
        yield opcode, content


def _unpacked(path: Path, chunk: bytes) -> bytes:
    """The records of a chunk."""
    _, _, size, checksum = struct.unpack_from("<QQQI", chunk)
    compression, at = _text_at(chunk, 28)
    records = chunk[at + 8 :]
    if compression or len(records) != size or zlib.crc32(records) != checksum:
        raise EpisodeError(f"{path}: a chunk is damaged, or was written by another program")
    return records


def _framed(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _block(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _text(text: str) -> bytes:
    return _block(text.encode())


def _map(values: dict[str, str]) -> bytes:
    return _block(b"".join(_text(key) + _text(value) for key, value in values.items()))


def _text_at(data: bytes, at: int) -> tuple[str, int]:
    """A text, and the place behind it."""
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length
