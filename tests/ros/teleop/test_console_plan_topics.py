"""The console's side of a plan: topics in, a place in the picture out; silent until asked."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rospy
from rospy.topics import get_topic_manager
from sensor_msgs.msg import JointState

import surg_core
from crtk_msgs.msg import OperatingState
from helpers.endoscope_files import lens
from helpers.graph.ros import RosGraph
from helpers.perception.live_eyes import camera_info
from surg_cli.host import paths
from surg_console.ros.plan_topics_node import FRESH
from surg_console.ros.ros_system_node import RosSystem
from surg_core.held_endoscope import held_endoscope
from surg_msgs.msg import Cycle, PolicyPlan

CELL = surg_core.load_cell(paths.CELLS / "sim_two_arms")
LENS = lens("left")
HOLDER = "ECM"
"""The arm that holds the endoscope."""
CYCLE, JOINTS = "/PSM1/cycle", f"/{HOLDER}/robot/measured_js"
SEEN = np.array([[-0.01, 0.002, 0.08], [0.012, -0.004, 0.1]])
"""[m] Planned tips before the left eye."""


def messages() -> dict[str, Any]:
    """A plan for PSM1 and what it takes to draw it, by topic."""
    held = held_endoscope(CELL)
    assert held is not None
    q = np.array(CELL.arms[held.arm].robot.home) + 0.01
    X_WV = held.X_WB @ np.asarray(held.chain.forward(q)) @ np.asarray(held.X_FV)
    # The rcm frame: turned by a third about (1, 1, 1), that is x to y to z, at the trocar.
    X_BR = np.eye(4)
    X_BR[:3, :3], X_BR[:3, 3] = np.roll(np.eye(3), 1, axis=0), [0.4, 0.1, 0.3]
    X_RV = np.linalg.inv(np.asarray(CELL.arms["PSM1"].X_WB) @ X_BR) @ X_WV
    p_R = SEEN @ X_RV[:3, :3].T + X_RV[:3, 3]
    rows = np.hstack([p_R, np.zeros((2, 2))])
    names = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
    plan = PolicyPlan(names=names, rows=2, values=rows.ravel().tolist(), area=[0, 0, 1, 1])
    plan.keypoints, plan.x, plan.y, plan.certainty = ["tip"], [0.5], [0.25], [1.0]
    return {
        CYCLE: Cycle(q_br=[0.5, 0.5, 0.5, 0.5], p_rcm=X_BR[:3, 3].tolist()),
        JOINTS: JointState(name=[j.name for j in held.chain.joints], position=q.tolist()),
        "/endoscope/left/camera_info": camera_info(LENS, rospy.Time()),
        "/policy/plan": plan,
    }


class Console:
    """The console's side of ROS as it runs, what is published for it, and PSM1 PAUSED."""

    def __init__(self, graph: RosGraph) -> None:
        self.said = messages() | {"/PSM1/operating_state": OperatingState(state="PAUSED")}
        self.said[CYCLE].state = Cycle.PAUSED
        self.out = {name: self._publisher(name) for name in self.said}
        self.graph = graph
        self.system = RosSystem(CELL, tuple(CELL.arms), "", "teleop", None)

    def _publisher(self, name: str) -> rospy.Publisher:
        return rospy.Publisher(name, type(self.said[name]), queue_size=1)

    def say(self) -> None:
        for name, message in self.said.items():
            self.out[name].publish(message)

    def listens(self) -> bool:
        """Whether it reads plans."""
        return self.out["/policy/plan"].get_num_connections() > 0

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        def met() -> bool:
            self.say()
            self.system.robot()  # as the page's status does, all the time
            return condition()

        self.graph.wait_for(met, 10.0, what)

    def hears_arm(self, code: int, when: str) -> None:
        """It hears a reason that only the topic `cycle` tells."""
        self.said[CYCLE].reason_code = code
        (reason,) = (r for r in surg_core.Reason.__members__.values() if int(r) == code)
        arm = list(CELL.arms).index("PSM1")
        self.wait(lambda: self.system.robot().arms[arm].reason == reason, f"the arm {when}")

    def open_both(self) -> None:
        """Open Scene and then Plan, each while what was there before hears."""
        self.hears_arm(Cycle.REASON_OPERATOR, "before anybody else")
        self.system.watch("scene", True)
        self.shows_endoscope("before the plan")
        self.system.watch("plan", True)

    def draws_way(self) -> None:
        def drawn() -> bool:
            text = self.system.overlay("plan")
            return bool(text) and bool(json.loads(text)["paths"])

        self.wait(drawn, "the way")

    def shows_endoscope(self, when: str) -> None:
        self.system.overlay("scene")  # what has waited until now counts as new
        rospy.sleep(FRESH)

        def shown() -> bool:
            return HOLDER not in json.loads(self.system.overlay("scene"))["silent"]

        self.wait(shown, f"the arm that holds the endoscope {when}")

    def restart(self, name: str) -> None:
        """Another publisher in the place of the first, which has ended before.

        In one process both have the same address, and rospy connects to no address twice.
        """
        self.out[name].unregister()
        impl = get_topic_manager().get_subscriber_impl(name)

        def ended() -> bool:
            self.system.robot()
            self.system.overlay("scene")
            return impl is None or impl.get_num_connections() == 0

        self.graph.wait_for(ended, 10.0, f"the end of {name}")
        self.out[name] = self._publisher(name)

    def close(self) -> None:
        for what in ("plan", "scene"):
            self.system.watch(what, False)
        self.system.close()  # later tests of this process have plain subscribers


@pytest.fixture
def console(ros_graph: RosGraph, rospy_node: str) -> Iterator[Console]:
    made = Console(ros_graph)
    yield made
    made.close()


@pytest.mark.ros
def test_a_running_console_draws_the_way_beside_the_scene(console: Console) -> None:
    """Three parts of it read the same topics; none takes a message from the others."""
    console.open_both()
    console.draws_way()
    console.hears_arm(Cycle.REASON_STALE, "beside the plan")
    console.shows_endoscope("beside the plan")


@pytest.mark.ros
def test_a_console_hears_its_arms_after_the_plan_is_closed(console: Console) -> None:
    console.hears_arm(Cycle.REASON_STALE, "before anybody has asked")
    assert not console.listens()
    console.open_both()
    console.draws_way()
    console.system.watch("plan", False)
    assert console.system.overlay("plan") == ""
    console.wait(lambda: not console.listens(), "the end of the plan")
    console.restart(CYCLE)
    console.hears_arm(Cycle.REASON_OPERATOR, "after a restart of its controller")
    console.restart(JOINTS)
    console.shows_endoscope("after a restart")
    console.system.watch("plan", True)
    console.draws_way()
