"""Virtual fixtures through the controller node: by cell.yaml, by topic, in lock-step."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import Point

from crtk_msgs.msg import StringStamped
from helpers.graph.control_rig import CELL, Rig, start, tip_in_rcm
from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_msgs.msg import Cycle, Fixture, Fixtures

pytestmark = [pytest.mark.ros, pytest.mark.untimed]


class Regions:
    """Says fixtures and hears which the arm has."""

    def __init__(self, graph: RosGraph, rig: Rig) -> None:
        self.heard: list[list[Fixture]] = []
        self.rig = rig
        self._set = rospy.Publisher("/PSM1/fixtures/set", Fixture, queue_size=10)
        self._remove = rospy.Publisher("/PSM1/fixtures/remove", StringStamped, queue_size=10)
        self._hear = rospy.Subscriber(
            "/PSM1/fixtures", Fixtures, lambda message: self.heard.append(message.fixtures)
        )
        graph.wait_for(
            lambda: self._set.get_num_connections() and self._remove.get_num_connections(),
            10.0,
            "the controller's fixture topics",
        )

    def set(self, **fields: object) -> Cycle:
        """Say a fixture and step."""
        self._set.publish(Fixture(**fields))
        self.rig.sent += 1
        return self.rig.step()

    def remove(self, name: str) -> Cycle:
        """Remove one and step."""
        self._remove.publish(StringStamped(string=name))
        self.rig.sent += 1
        return self.rig.step()


def ball(p_B: np.ndarray, **fields: object) -> dict[str, object]:
    """A sphere of 5 mm that the tip keeps out of."""
    sphere = {"shape": "sphere", "side": "keep_out", "of": "tip", "radius": 0.005}
    return {"name": "ball", "point": Point(*p_B), **sphere, **fields}


def press(rig: Rig, begin: np.ndarray, by: float, ticks: int) -> Cycle:
    """A hand that moves `by` [m] along x of the rcm frame, smoothly there and no farther."""
    for k in range(ticks):
        share = 0.5 * (1.0 - math.cos(math.pi * min(1.0, 2.0 * k / ticks)))
        rig.pose(begin + np.array([share * by, 0.0, 0.0]))
        cycle = rig.step()
    return cycle


def test_f34_fixtures_by_topic_hold_the_tip(ros_graph: RosGraph, rig: Rig) -> None:
    start(ros_graph, rig)
    regions = Regions(ros_graph, rig)
    cycle = rig.enable()
    begin = tip_in_rcm(cycle)
    tip = np.array(cycle.p_tip)
    # 9 mm along x of the rcm frame: a wall 4 mm in front of the tip.
    rig.pose(begin)
    x = axis_x(cycle)
    assert regions.set(**ball(tip + 0.009 * x)).accepted
    cycle = press(rig, begin, 0.008, 600)
    assert cycle.reason == "fixture"
    assert math.dist(cycle.p_tip, tip + 0.009 * x) > 0.005 - 1e-5
    assert math.dist(cycle.p_tip, tip + 0.004 * x) < 2e-4, "it stands at the wall"

    refused = rig.texts
    regions.set(**ball(tip))
    assert "fixture_while_enabled" in repr(refused) or rig.wait_text("warning", "not ENABLED")
    regions.remove("ball")
    rig.wait_text("warning", "fixtures/remove")
    for wrong, part in (
        ({"radius": 0.0}, "radius 0"),
        ({"radius": float("nan")}, "radius nan"),
        ({"shape": "cube"}, "plane, sphere, capsule"),
        ({"name": "a ball"}, "letters, digits"),
        ({"name": "x" * 40}, "31"),
    ):
        cycle = regions.set(**{**ball(tip), "name": "other", **wrong})
        rig.wait_text("warning", part)
        assert np.allclose(cycle.qd_command, 0.0, atol=1e-3), "bad input never moves the arm"
        for _ in range(510):  # a warning of one kind comes once a second, in simulated time
            rig.step()
    rig.say("pause")
    rig.step()
    regions.remove("ball")
    ros_graph.wait_for(lambda: regions.heard and not regions.heard[-1], 5.0, "an empty list")
    assert [[f.name for f in heard] for heard in regions.heard] == [[], ["ball"], []]


def axis_x(cycle: Cycle) -> np.ndarray:
    """The x axis of the rcm frame in B."""
    x, y, z, w = cycle.q_br
    return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])


def test_fixtures_of_the_cell_hold_from_the_start(
    ros_graph: RosGraph, rig: Rig, tmp_path: Path
) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    text = (cell / "cell.yaml").read_text().replace("../../src", str(paths.ROOT / "src"))
    text += (
        "    fixtures:\n"
        "      floor: {shape: plane, side: stay_in, of: tip, point: [0.0, 0.0, -2.0], "
        "normal: [0.0, 0.0, 1.0]}\n"
    )
    (cell / "cell.yaml").write_text(text)
    start(ros_graph, rig, cell=cell)
    regions = Regions(ros_graph, rig)
    rig.step()
    ros_graph.wait_for(lambda: regions.heard, 5.0, "the cell's fixtures")
    (floor,) = regions.heard[-1]
    assert (floor.name, floor.shape, floor.side, floor.of_cell) == (
        "floor",
        "plane",
        "stay_in",
        True,
    )
    assert (floor.point.z, floor.normal.z) == (-2.0, 1.0)
    regions.remove("floor")
    rig.wait_text("warning", "fixtures/remove")
    assert len(regions.heard) == 1
