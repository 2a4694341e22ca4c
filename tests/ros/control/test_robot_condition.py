"""F33 through the node: the link's status is part of the tick, and its sentence reaches people."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.graph.control_rig import Rig, follow, start
from helpers.graph.ros import RosGraph
from surg_msgs.msg import Cycle, LinkStatus

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

SENTENCE = "protective stop on joint 3: unlock it on the pendant"


def test_f33_a_condition_faults_in_its_own_tick_with_the_links_sentence(
    ros_graph: RosGraph, rig: Rig
) -> None:
    start(ros_graph, rig)
    assert np.any(follow(rig, 60)[-1].qd_command)
    rig.says = {"condition": LinkStatus.STOPPED, "fault": SENTENCE}
    cycle = rig.step()
    assert (cycle.state, cycle.reason) == (Cycle.FAULT, "robot")
    assert not np.any(cycle.qd_command)
    rig.wait_text("error", SENTENCE)
    for word in ("enable", "home"):
        rig.say(word)
        assert rig.step().state == Cycle.FAULT
        assert SENTENCE in rig.wait_text("warning", f"{word} from")
    rig.says = {"condition": LinkStatus.ACTIVE}
    for _ in range(50):
        cycle = rig.step()
        assert cycle.state == Cycle.FAULT and not np.any(cycle.qd_command)
    rig.say("enable")
    assert rig.step().state == Cycle.ENABLED


def test_f33_a_robot_that_is_not_started_is_not_enabled(ros_graph: RosGraph, rig: Rig) -> None:
    rig.says = {"condition": LinkStatus.READY}
    start(ros_graph, rig)
    rig.step()
    rig.say("enable")
    assert rig.step().state == Cycle.DISABLED
    rig.wait_text("warning", "not started")
    rig.says = {"condition": LinkStatus.ACTIVE}
    rig.step()
    rig.say("enable")
    assert rig.step().state == Cycle.ENABLED


def test_f33_a_link_that_obeys_another_command_is_named_with_both(
    ros_graph: RosGraph, rig: Rig
) -> None:
    rig.says = {"condition": LinkStatus.ACTIVE, "command": "cartesian_velocity"}
    start(ros_graph, rig)
    rig.step()
    rig.say("enable")
    assert rig.step().state == Cycle.DISABLED
    refusal = rig.wait_text("warning", "enable from")
    assert "'cartesian_velocity'" in refusal and "'joint_velocity'" in refusal
