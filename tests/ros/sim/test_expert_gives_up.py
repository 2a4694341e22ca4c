"""A scripted sender that gives up says why on its status."""

from types import SimpleNamespace

import pytest


@pytest.mark.untimed
def test_the_reason_is_published_once() -> None:
    from surg_msgs.msg import SenderStatus, TaskState
    from surg_sim.nodes.expert_node import ExpertNode

    sent: list[SenderStatus] = []
    action = SimpleNamespace(arms={}, assistant=None)
    expert = SimpleNamespace(tick=lambda _: action, reason="the arm is in FAULT")
    node = SimpleNamespace(
        _expert=expert,
        _reason="",
        _awaited=set(),
        _seed=0,
        _ports={},
        _status=SimpleNamespace(publish=sent.append),
    )
    task = TaskState(names=[], values=[])
    for tick in (25, 50):
        ExpertNode._act(node, SimpleNamespace(tick=tick, task=task, cycles={}, stamp_ns=0))
    (status,) = sent
    assert (status.stage, status.detail) == (SenderStatus.STAGE_FAILED, "the arm is in FAULT")
    assert status.version == SenderStatus.VERSION and not status.header.stamp.is_zero()
