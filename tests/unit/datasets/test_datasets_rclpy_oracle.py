"""Our bags of ROS 2, read by the real rclpy.

Opt-in: `./surg test --tier oracle`.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from helpers.recording import bag_messages, datasets_synthetic
from helpers.results.dataset_results import note
from helpers.ros2 import interfaces
from helpers.ros2.plain_values import values
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

pytestmark = pytest.mark.oracle

SCRIPT = Path(interfaces.__file__).with_name("rclpy_bag.py")


def test_rclpy_reads_every_field_of_our_bags(tmp_path: Path) -> None:
    """Equal to the bag of ROS 1 of the same recording, to the bit."""
    recording = datasets_synthetic.record(tmp_path / "episode", 3, 6.0)
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    for name in ("rosbag", "rosbag2_sqlite3"):
        assert datasets.load(name).write([recording], tmp_path / name, options).ok
    (bag,) = (tmp_path / "rosbag").glob("episode_*")
    (twin,) = (tmp_path / "rosbag2_sqlite3").rglob("*.db3")
    python, env = interfaces.rclpy()
    words = [str(python), str(SCRIPT), str(twin)]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    theirs = [json.loads(line) for line in done.stdout.splitlines()]
    ours = [[topic, ns, values(m)] for topic, m, ns in bag_messages.read("rosbag", bag)]

    def by_topic(messages: list[list[object]]) -> list[str]:
        return sorted(json.dumps(each, sort_keys=True) for each in messages)

    assert by_topic(theirs) == by_topic(ours)
    kinds = {topic for topic, _, _ in theirs}
    note("bags of ROS 2, read by rclpy 9.1.2", len(theirs), f"{len(kinds)} topics, fields equal")
    assert len(kinds) > 5 and len(theirs) > 500
