"""MCAP: ROS 1 messages for Foxglove, Rerun and the ``mcap`` program."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from surg_recording.nodes.bag_exporter_node import BagExporter
from surg_recording.nodes.ros_messages_node import Stamped, serialised
from surg_recording.recording_errors import EpisodeError


class Mcap(BagExporter):
    """One MCAP file per recording; its chunks are not compressed, for nearly all bytes are JPEG."""

    name = "mcap"
    title = "MCAP (ROS 1 messages; Foxglove, Rerun)"
    suffix = ".mcap"
    needs: ClassVar[Mapping[str, str]] = {
        **BagExporter.needs,
        "mcap": "pip: 'surg_recording[mcap]'",
    }

    def write_file(self, path: Path, stamped: Iterable[Stamped], facts: Mapping[str, str]) -> None:
        """Write messages, given in the order of their time."""
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        sent: Counter[str] = Counter()
        with open(path, "wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start("ros1", "surg_recording")
            writer.add_metadata("recording", dict(facts))
            for time_ns, topic, message in stamped:
                kind = message._type
                if kind not in schemas:
                    definition = message._full_text.encode()
                    schemas[kind] = writer.register_schema(kind, "ros1msg", definition)
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "ros1", schemas[kind])
                data = serialised(message)
                writer.add_message(channels[topic], time_ns, data, time_ns, sent[topic])
                sent[topic] += 1
            writer.finish()

    def read_file(self, path: Path) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and serialised message of every message, in file order.

        Raises:
            EpisodeError: The file was cut or damaged.
        """
        try:
            with open(path, "rb") as file:
                reader = NonSeekingReader(file, validate_crcs=True)
                for schema, channel, message in reader.iter_messages(log_time_order=False):
                    kind = "" if schema is None else schema.name
                    yield message.log_time, channel.topic, kind, message.data
        except (McapError, ValueError, struct.error) as problem:
            raise EpisodeError(f"{path}: cut or damaged ({problem})") from None
