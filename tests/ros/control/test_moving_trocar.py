"""A trocar that breathes, tracked 20 ms late: simulator, controller and client in lock-step.

Two deviations are stated. The kinematic one is to the point that the controller takes for the
trocar; the true one is the simulator's, to where the trocar is now.
"""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
import rospy

from helpers.graph.crtk_client import TICK, Arm, LockstepTime, position
from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_msgs.msg import Cycle, GroundTruth

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

CELL = paths.ROOT / "cells" / "sim_ur5e"
STALE = 0.020
BEGIN = 100  # tick; the trocar moves at its full speed at once
SETTLED = 225  # ticks in which the track filter has found that speed
KINDS = {"kinematic": "kinematic", "true": "true", "settled": "true, from 0.45 s on"}
MOTION = {"fault": "trocar_motion", "amplitude": 0.005, "frequency": 0.25, "axis": [0, 1, 0]}


def breathe(graph: RosGraph, node: str, seconds: float, tracked: bool) -> dict[str, np.ndarray]:
    """Hold the tip while the trocar moves; returns deviations and the tip's way, by tick [m]."""
    shared = {"cell": CELL, "mode": "lockstep"}
    me = node.lstrip("/")
    graph.node(
        "surg_sim",
        "bridge_node.py",
        "/sim",
        {
            **shared,
            "participants": [me],
            "faults": json.dumps({**MOTION, "at": BEGIN}),
            "track_stale": STALE if tracked else -1,
        },
    )
    graph.node(
        "surg_control",
        "rcm_node",
        "/PSM1/controller",
        {
            **shared,
            "arm": "PSM1",
            "participants": [me, "sim"] if tracked else [me],
            "track_rcm": tracked,
        },
    )
    cycles: dict[int, Cycle] = {}
    truths: dict[int, GroundTruth] = {}
    keys = {"queue_size": None, "tcp_nodelay": True}
    ears = [
        rospy.Subscriber("/PSM1/cycle", Cycle, lambda m: cycles.update({m.tick: m}), **keys),
        rospy.Subscriber(
            "/sim/ground_truth/state", GroundTruth, lambda m: truths.update({m.tick: m}), **keys
        ),
    ]
    clock = LockstepTime(node, "PSM1")
    arm = Arm("PSM1", clock)
    try:
        arm.check_connections()
        graph.wait_for(clock.connected, 20.0, "the clock")
        graph.wait_for(lambda: all(e.get_num_connections() for e in ears), 20.0, "ears")
        arm.sleep(0.02)
        assert arm.enable(1.0) and arm.home(1.0)
        start = position(arm.get("measured_cp"))
        assert np.linalg.norm(start) > 0.1
        arm.sleep(seconds)
        last = clock.tick
        graph.wait_for(lambda: last in cycles and last in truths, 10.0, "the last tick")
    finally:
        arm.close()
        clock.close()
        for ear in ears:
            ear.unregister()
    ticks = range(150, last)
    assert {cycles[k].state for k in ticks} == {Cycle.ENABLED}, cycles[last].reason
    return {
        "kinematic": np.array([cycles[k].rcm_error for k in ticks]),
        "true": np.array([true_deviation(truths[k]) for k in ticks]),
        "settled": np.array([true_deviation(truths[k]) for k in ticks if k >= BEGIN + SETTLED]),
        "tip": np.array([cycles[k].p_tip for k in ticks]),
        "trocar": np.array([[getattr(truths[k].arms[0].trocar, i) for i in "xyz"] for k in ticks]),
    }


def true_deviation(message: GroundTruth) -> float:
    arm = message.arms[0]
    s = np.array([getattr(arm.shaft_axis, i) for i in "xyz"])
    d = np.array([getattr(arm.trocar, i) - getattr(arm.shaft_point, i) for i in "xyz"])
    return float(np.linalg.norm(d - (d @ s) * s))


def test_a_tracked_trocar_is_followed(ros_graph: RosGraph, rospy_node: str, full: bool) -> None:
    began = time.monotonic()
    seen = breathe(ros_graph, rospy_node, 8.0 if full else 2.0, tracked=True)
    moved = np.ptp(seen["trocar"][:, 1])
    sway = np.linalg.norm(seen["tip"] - seen["tip"][0], axis=1).max()
    rows = [
        f"| {said} | {_um(seen[name].mean())} | {_um(seen[name].max())} |"
        for name, said in KINDS.items()
    ]
    rows.append(f"| tip from where it was | – | {_um(sway)} |")
    title = f"{len(seen['true']) * TICK:.1f} s, trocar moved {moved * 1e3:.2f} mm"
    print(title, *rows, f"{time.monotonic() - began:.0f} s", sep="\n")
    assert moved > 0.004
    assert seen["kinematic"].mean() < 5e-6
    # The trocar begins at its full speed of 7.85 mm/s. Without a tracker it would be 5 mm.
    assert seen["true"].max() < 4e-4
    assert seen["settled"].max() < 5e-5
    assert sway < 2e-3


def _um(metres: float) -> str:
    return f"{metres * 1e6:.1f}"
