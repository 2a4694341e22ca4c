"""Bags of ROS 2, written without ROS 2."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from surg_recording.imports.bag_file import BagFile, learn
from surg_recording.nodes.bag_exporter_node import BagExporter
from surg_recording.nodes.ros_messages_node import Stamped, serialised

VERSION = 9
"""Of metadata.yaml; the newest that rosbags writes."""


class Rosbag2(BagExporter):
    """One bag per recording: a folder with messages in CDR, their types and ``metadata.yaml``."""

    name = "rosbag2"
    title = "rosbag2 (ROS 2, MCAP)"
    suffix = ""
    storage: ClassVar[StoragePlugin] = StoragePlugin.MCAP
    needs: ClassVar[Mapping[str, str]] = {
        **BagExporter.needs,
        "rosbags": "pip: 'surg_recording[bags]'",
    }

    def write_file(self, path: Path, stamped: Iterable[Stamped], facts: Mapping[str, str]) -> None:
        """Write messages, given in the order of their time; ``facts`` are the custom data."""
        types, topics = get_typestore(Stores.ROS2_HUMBLE), {}
        with Writer(path, version=VERSION, storage_plugin=self.storage) as bag:
            for key, value in facts.items():
                bag.set_custom_data(key, value)
            for time_ns, topic, message in stamped:
                kind = message._type.replace("/", "/msg/")
                if topic not in topics:
                    learn(types, kind, message._full_text)
                    topics[topic] = bag.add_connection(topic, kind, typestore=types)
                bag.write(topics[topic], time_ns, types.ros1_to_cdr(serialised(message), kind))

    def read_file(self, path: Path) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and message, serialised as in ROS 1, in order of time."""
        with BagFile(path) as bag:
            yield from bag.as_ros1()
