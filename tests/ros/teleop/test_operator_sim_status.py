"""The player of motions ends with the simulation, and only by a status that it understands."""

import threading
from types import SimpleNamespace

import pytest


@pytest.mark.untimed
def test_only_a_valid_status_ends_the_motion() -> None:
    import rospy

    from surg_core.status_check import LatestStatus
    from surg_msgs.msg import SimStatus, TaskStatus
    from surg_teleop.playback.operator_node import OperatorNode

    node = SimpleNamespace(_sim=LatestStatus("/sim/status"), finished=threading.Event())

    def hear(version: int, state: int) -> bool:
        message = SimStatus(version=version, state=state, mode=SimStatus.MODE_LOCKSTEP)
        message.header.stamp = rospy.Time(1)
        message.task.state = TaskStatus.STATE_NONE
        OperatorNode._on_sim_status(node, message)
        return node.finished.is_set()

    good = SimStatus.VERSION
    assert not hear(good, SimStatus.STATE_RUNNING)
    for _ in range(3):  # only the first one is reported, and none ends anything
        assert not hear(good + 1, SimStatus.STATE_DONE)
    for _ in range(3):
        assert not hear(good, 0)
    assert hear(good, SimStatus.STATE_DONE)
