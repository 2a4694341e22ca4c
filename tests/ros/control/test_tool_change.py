"""Another calibration without a restart: simulator, controller and client in lock-step.

The oracle is the simulator's true tip. The simulator keeps its instrument; what changes is the
controller's tool, from one that is 1 mm off to the exact one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rospy
from std_msgs.msg import String

from crtk_msgs.msg import StringStamped
from helpers.graph.crtk_client import Arm, Group, LockstepTime
from helpers.graph.ros import RosGraph
from surg_cli.host import paths
from surg_msgs.msg import Cycle, GroundTruth

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

INSTRUMENT = paths.ROOT / "src" / "surg_description" / "instruments" / "grasper.yaml"
TOOL = """\
format: surg_tool/1
shaft_axis: [0.0, 0.0, {axis}]
tip: [{x}, 0.0, 0.3]
residual: 0.0
n: 1
condition: 1.0
date: "2026-11-21"
"""


def write_cell(folder: Path) -> Path:
    """The bundled cell with a tool that is 1 mm off, an exact one and a broken one."""
    bundled = paths.ROOT / "cells" / "sim_ur5e"
    (folder / "calibration").mkdir(parents=True)
    text = (bundled / "cell.yaml").read_text("utf-8")
    (folder / "cell.yaml").write_text(text.replace("../..", str(paths.ROOT)), "utf-8")
    trocar = bundled / "calibration" / "trocar_PSM1.yaml"
    (folder / "calibration" / trocar.name).write_bytes(trocar.read_bytes())
    for name, axis, x in (("tool_PSM1", 1.0, 0.061), ("exact", 1.0, 0.06), ("broken", 2.0, 0.06)):
        (folder / "calibration" / f"{name}.yaml").write_text(TOOL.format(axis=axis, x=x), "utf-8")
    return folder


class Watched:
    """A CRTK client that can change the tool, with what controller and simulator say."""

    def __init__(self, graph: RosGraph, node: str, cell: Path) -> None:
        me = node.lstrip("/")
        shared = {"cell": cell, "mode": "lockstep", "participants": [me]}
        graph.node("surg_sim", "bridge_node.py", "/sim", shared)
        graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
        self.cycles: dict[int, Cycle] = {}
        self.truths: dict[int, GroundTruth] = {}
        self.texts: list[str] = []
        self.mounted: list[str] = []
        self.clock = LockstepTime(node, "PSM1")
        self.arm = Arm("PSM1", self.clock)
        tool = Group("PSM1/tool", self.clock)
        self.arm.groups.append(tool)
        self._mount = tool.speak("mount", StringStamped)
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._ears = [
            rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, **keys),
            rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._on_truth, **keys),
            rospy.Subscriber("/PSM1/warning", String, lambda m: self.texts.append(m.data)),
            rospy.Subscriber("/PSM1/status", String, lambda m: self.texts.append(m.data)),
            rospy.Subscriber(
                "/PSM1/tool/mounted", StringStamped, lambda m: self.mounted.append(m.string)
            ),
        ]
        self.arm.check_connections()
        graph.wait_for(self.clock.connected, 20.0, "the clock")
        graph.wait_for(lambda: all(e.get_num_connections() for e in self._ears), 20.0, "ears")
        self._graph = graph
        self.arm.sleep(0.02)

    def _on_cycle(self, message: Cycle) -> None:
        self.cycles[message.tick] = message

    def _on_truth(self, message: GroundTruth) -> None:
        self.truths[message.tick] = message

    def mount(self, words: str, expected: str) -> None:
        """Ask for a tool; the controller's text must hold ``expected``."""
        self._mount(StringStamped(string=words))
        self.arm.sleep(0.02)
        self._graph.wait_for(
            lambda: any("tool/mount" in t and expected in t for t in self.texts),
            5.0,
            f"'{expected}' in {self.texts}",
        )

    def tip_errors(self, first: int) -> np.ndarray:
        """Distance of the controller's tip to the simulator's, by tick [m]."""
        last = self.clock.tick
        self._graph.wait_for(lambda: last in self.cycles and last in self.truths, 10.0, "ticks")
        told = np.array([self.cycles[k].p_tip for k in range(first, last)])
        true = np.array(
            [[getattr(self.truths[k].arms[0].tip, i) for i in "xyz"] for k in range(first, last)]
        )
        return np.linalg.norm(told - true, axis=1)

    def newest(self) -> Cycle:
        last = self.clock.tick
        self._graph.wait_for(lambda: last in self.cycles, 10.0, "the last tick")
        return self.cycles[last]

    def close(self) -> None:
        self.arm.close()
        self.clock.close()
        for ear in self._ears:
            ear.unregister()


def test_a_tool_change_without_a_restart(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    seen = Watched(ros_graph, rospy_node, write_cell(tmp_path / "cell"))
    arm, exact = seen.arm, f"{INSTRUMENT} calibration/exact.yaml"
    try:
        assert arm.enable(1.0) and arm.home(1.0)
        first = seen.clock.tick
        assert arm.move_jp(np.array([0.1, 0.0, 0.12, 0.0])).wait()
        wrong = seen.tip_errors(first)
        seen.mount(exact, "DISABLED")
        assert seen.newest().homed and seen.newest().state == Cycle.ENABLED
        assert arm.disable(1.0)
        arm.sleep(0.5)
        seen.mount(f"{INSTRUMENT} calibration/broken.yaml", "broken.yaml:2: shaft_axis")
        assert seen.newest().homed, "a refused tool changes nothing"
        seen.mount(exact, "home the arm again")
        assert not seen.newest().homed
        assert arm.enable(1.0) and arm.home(1.0)
        first = seen.clock.tick
        assert arm.move_jp(np.array([-0.1, 0.1, 0.12, 0.3])).wait(), seen.texts
        right = seen.tip_errors(first)
        print(f"tip off by {wrong.mean() * 1e6:.0f} um, then by {right.mean() * 1e6:.1f} um")
        assert wrong.min() > 9e-4
        assert right.max() < 5e-5
        assert seen.mounted[-1] == exact
        assert max(seen.cycles[k].rcm_error for k in range(first, seen.clock.tick)) < 1e-3
    finally:
        seen.close()
