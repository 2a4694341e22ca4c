"""Bags of ROS 1, for ``rosbag``, ``rqt_bag`` and programs of dVRK."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

import rosbag

from surg_recording.nodes.bag_exporter_node import BagExporter
from surg_recording.nodes.ros_messages_node import Stamped, ros_time


class Rosbag(BagExporter):
    """One bag per recording; ``facts`` stand in ``dataset.json`` only."""

    name = "rosbag"
    title = "rosbag (ROS 1, format 2.0)"
    suffix = ".bag"
    needs: ClassVar[Mapping[str, str]] = {
        **BagExporter.needs,
        "rosbag": "ROS 1, which ./surg dev setup installs",
    }

    def write_file(self, path: Path, stamped: Iterable[Stamped], facts: Mapping[str, str]) -> None:
        """Write messages, given in the order of their time."""
        with rosbag.Bag(str(path), "w") as bag:
            for time_ns, topic, message in stamped:
                bag.write(topic, message, ros_time(time_ns))

    def read_file(self, path: Path) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and serialised message of every message, in order of time."""
        with rosbag.Bag(str(path)) as bag:
            for topic, (kind, data, *_), time in bag.read_messages(raw=True):
                yield time.to_nsec(), topic, kind, data
