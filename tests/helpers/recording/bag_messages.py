"""Reads exported bags with ROS's own classes of messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rosbag
import roslib.message

from surg_recording import datasets

FORMATS = ("rosbag", "mcap", "rosbag2", "rosbag2_sqlite3")


def read(format_name: str, file: Path) -> Iterator[tuple[str, Any, int]]:
    """Topic, message and time of every message."""
    if format_name == "rosbag":
        with rosbag.Bag(str(file)) as bag:
            for topic, message, time in bag.read_messages():
                yield topic, message, time.to_nsec()
        return
    for time_ns, topic, kind, data in datasets.load(format_name).read_file(file):
        message = roslib.message.get_message_class(kind)()
        message.deserialize(data)
        yield topic, message, time_ns
