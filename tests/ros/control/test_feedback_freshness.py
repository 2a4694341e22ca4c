"""Feedback is fresh enough for public clients: a read fails when it is older than 20 ms.

``crtk_teleop_example.py`` and ``dvrk_teleoperation.py`` read poses at 200 to 500 Hz. A read takes
the newest message if its stamp is at most 20 ms old, or waits 20 ms for the next one, and then
gives up. Their subscriptions do not ask for TCP_NODELAY.
"""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from helpers.graph.crtk_client import Arm, WallTime
from helpers.graph.ros import RosGraph
from surg_cli.host import paths

pytestmark = pytest.mark.ros

EXPECTED = 0.02
"""[s] ``expected_interval`` of the public clients."""
PERIOD = 0.005
"""[s] between two reads of dvrk_teleoperation.py."""


class Reader:
    """One pose as a public client keeps it."""

    def __init__(self, topic: str) -> None:
        self.stamps: list[tuple[float, float]] = []
        self._event = threading.Event()
        self._subscriber = rospy.Subscriber(topic, PoseStamped, self._on_pose, queue_size=10)

    def _on_pose(self, message: PoseStamped) -> None:
        self.stamps.append((time.time(), message.header.stamp.to_sec()))
        self._event.set()

    def read(self) -> bool:
        """Whether a client would have got the pose."""
        self._event.clear()
        fresh = bool(self.stamps) and time.time() - self.stamps[-1][1] <= EXPECTED
        return fresh or self._event.wait(EXPECTED)

    def close(self) -> None:
        self._subscriber.unregister()


def test_a_public_client_reads_poses_at_its_own_rate(
    ros_graph: RosGraph, rospy_node: str, full: bool
) -> None:
    if not full:
        pytest.skip("measures in real time: --full")
    cell = paths.ROOT / "cells" / "sim_ur5e"
    shared = {"cell": cell, "mode": "freerun"}
    ros_graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
    arm = Arm("PSM1", WallTime())
    readers = [Reader(f"/PSM1/{name}") for name in ("measured_cp", "setpoint_cp")]
    arm.check_connections(30.0)
    ros_graph.wait_for(lambda: arm.enable(2.0) and arm.home(2.0), 30.0, "an arm at home")
    ros_graph.wait_for(lambda: all(r.stamps for r in readers), 10.0, "the poses")
    for reader in readers:
        reader.stamps.clear()
    missed = reads = 0
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        reads += len(readers)
        missed += sum(not reader.read() for reader in readers)
        time.sleep(PERIOD)
    for reader, name in zip(readers, ("measured_cp", "setpoint_cp"), strict=True):
        heard = np.array(reader.stamps)
        gaps, ages = 1e3 * np.diff(heard[:, 0]), 1e3 * (heard[:, 0] - heard[:, 1])
        rate = (len(heard) - 1) / (heard[-1, 0] - heard[0, 0])
        print(
            f"{name}: {rate:.0f} Hz, gap p99 {np.percentile(gaps, 99):.1f} ms, worst "
            f"{gaps.max():.1f} ms; age p50 {np.median(ages):.1f} ms, p99 "
            f"{np.percentile(ages, 99):.1f} ms, worst {ages.max():.1f} ms"
        )
        reader.close()
    arm.close()
    print(f"{missed} of {reads} reads in vain")
    assert missed <= reads // 100
