"""MCAP: ROS 1 messages for Foxglove, Rerun and the ``mcap`` program."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from surg_recording import mcap_file
from surg_recording.nodes.bag_exporter_node import BagExporter
from surg_recording.nodes.ros_messages_node import Stamped


class Mcap(BagExporter):
    """One MCAP file per recording."""

    name = "mcap"
    title = "MCAP (ROS 1 messages; Foxglove, Rerun)"
    suffix = ".mcap"

    def write_file(self, path: Path, stamped: Iterable[Stamped], facts: Mapping[str, str]) -> None:
        """Write messages, given in the order of their time."""
        with open(path, "wb") as file:
            writer = mcap_file.McapWriter(file, dict(facts))
            for time_ns, topic, message in stamped:
                buffer = io.BytesIO()
                message.serialize(buffer)
                kind, definition = message._type, message._full_text
                writer.write(topic, kind, definition, buffer.getvalue(), time_ns)
            writer.close()

    def read_file(self, path: Path) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and serialised message of every message, in file order."""
        for topic, kind, time_ns, data in mcap_file.messages(path):
            yield time_ns, topic, kind, data
