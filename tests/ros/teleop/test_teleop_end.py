"""The end of the teleoperation is bounded, whatever hangs."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_teleop.follow.teleop_node import END

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


def test_a_device_that_hangs_does_not_keep_the_node(ros_graph: RosGraph) -> None:
    """In the middle of the work, or only when it is let go: two nodes, for a test costs seconds."""
    path = Path(ros_graph.folder, "stuck.py")
    path.write_text(STUCK)
    children = []
    for where in ("read", "close"):
        params = {"cell": CELL, "leader": path, "settings": {"where": where}, "picture": ""}
        node = ros_graph.node("surg_teleop", "teleop_node", f"/teleop_{where}", params)
        children.append(node)
    for child in children:
        ros_graph.wait_for(lambda c=child: "opened" in c.log_tail(5), 30.0, child.name)
    told = time.monotonic()
    for child in children:
        child.process.send_signal(signal.SIGTERM)
    for child in children:
        assert child.process.wait(END + 8.0) == 1
        print(f"{child.name} gone {time.monotonic() - told:.1f} s after it was told")
        assert "hangs 2 s after the shutdown began" in child.log_tail(5)
