"""Bags of ROS 2 in the storage that was its default before Iron."""

from __future__ import annotations

from rosbags.rosbag2 import StoragePlugin

from surg_recording.nodes.rosbag2_exporter_node import Rosbag2


class Rosbag2Sqlite3(Rosbag2):
    """As ``rosbag2``, in SQLite 3."""

    name = "rosbag2_sqlite3"
    title = "rosbag2 (ROS 2, SQLite 3)"
    storage = StoragePlugin.SQLITE3
