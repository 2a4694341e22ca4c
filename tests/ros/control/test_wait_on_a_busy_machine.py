"""A client's ``wait()`` returns for every move, however late the machine is."""

from __future__ import annotations

import os
import random
import time

import pytest

from helpers.graph.busy_machine import busy
from helpers.graph.crtk_client import Arm, WallTime
from helpers.graph.ros import RosGraph
from surg_cli.host import paths

pytestmark = [pytest.mark.ros, pytest.mark.full, pytest.mark.untimed]

WAITS = int(os.environ.get("SURG_WAITS", "1000"))
HANGS = 20.0
"""A wait of this length hangs [s]."""
PATIENCE = 600.0
"""To be at home again [s]: a starved simulator ends in FAULT(link) more than once on the way."""


def changes(rng: random.Random) -> list[float]:
    """Of yaw, pitch, insertion and roll: small, none, or out of reach."""
    size = rng.choice([1e-3, 4e-3, 0.0, 9.0])
    return [rng.uniform(-size, size), rng.uniform(-size, size), 0.0, rng.uniform(-size, size)]


@pytest.mark.parametrize("cell", ["sim_ur5e", "sim_panda"])
def test_wait_returns_for_every_move(
    ros_graph: RosGraph, rospy_node: str, rng: random.Random, cell: str
) -> None:
    shared: dict[str, object] = {"cell": paths.ROOT / "cells" / cell, "mode": "freerun"}
    ros_graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
    arm = Arm("PSM1", WallTime())
    arm.check_connections(60.0)

    def ready() -> bool:
        return arm.enable(5.0) and arm.home(5.0)

    ros_graph.wait_for(ready, 60.0, "an arm at home")
    lengths, stopped = [], 0
    with busy():
        start = arm.get("measured_js", 10.0, 10.0).position
        for _ in range(WAITS):
            if arm.state.state != "ENABLED":
                stopped += 1
                ros_graph.wait_for(ready, PATIENCE, "an arm at home again")
            began = time.monotonic()
            goal = [a + b for a, b in zip(start, changes(rng), strict=True)]
            returned = arm.move_jp(goal).wait(timeout=HANGS)  # type: ignore[arg-type]
            lengths.append(time.monotonic() - began)
            assert returned, f"wait {len(lengths)} hangs"
        load = os.getloadavg()[0]
    arm.close()
    lengths.sort()
    print(
        f"{cell}: {len(lengths)} waits at load {load:.0f}, none hangs; median "
        f"{lengths[len(lengths) // 2]:.3f} s, longest {lengths[-1]:.2f} s; enabled anew {stopped}"
    )
