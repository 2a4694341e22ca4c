"""The end of the teleoperation is bounded, whatever hangs."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from helpers.ros import RosGraph
from surg_cli import paths
from surg_teleop.teleop_node import END

pytestmark = pytest.mark.ros

CELL = paths.CELLS / "sim_two_arms"
STUCK = '''"""A device whose driver never comes back."""
import time


class Stuck:
    def __init__(self, where="close"):
        self.name, self.where = "stuck", where

    def open(self):
        print("opened", flush=True)

    def read(self, now):
        self.hang("read")

    def close(self):
        self.hang("close")

    def hang(self, where):
        while where == self.where:
            time.sleep(1.0)
'''


@pytest.mark.parametrize("where", ["read", "close"])
def test_a_device_that_hangs_does_not_keep_the_node(where: str, ros_graph: RosGraph) -> None:
    path = Path(ros_graph.folder, "stuck.py")
    path.write_text(STUCK)
    params = {"cell": CELL, "leader": path, "settings": {"where": where}, "picture": ""}
    child = ros_graph.node("surg_teleop", "teleop_node", "/teleop", params)
    ros_graph.wait_for(lambda: "opened" in child.log_tail(5), 30.0, "the node")
    told = time.monotonic()
    child.process.send_signal(signal.SIGTERM)
    assert child.process.wait(END + 8.0) == 1
    print(f"gone {time.monotonic() - told:.1f} s after it was told")
    assert "something hangs 2 s after the end was asked for" in child.log_tail(5)
