"""Topics that stay bytes: nothing lost, doubled or mixed up between consumers of one process."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from helpers.graph.ros import RosGraph

pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore:The publisher should be")]

_names = itertools.count()


def packed(value: float, padding: int = 0) -> bytes:
    from sensor_msgs.msg import JointState

    buffer = io.BytesIO()
    JointState(position=[value], effort=[0.0] * padding).serialize(buffer)
    return buffer.getvalue()


class Link:
    """A topic with a publisher of bytes and one subscriber, of as many as a test wants."""

    def __init__(self, graph: RosGraph) -> None:
        from sensor_msgs.msg import JointState

        from surg_ros.byte_topics import BytesPublisher

        self.graph, self.kind = graph, JointState
        self.topic = f"/bytes_{next(_names)}"
        self.made: list[Any] = []
        self.first = self.another()
        self.out = BytesPublisher(self.topic, JointState, blocking=True)
        self.wait(lambda: self.first.get_num_connections() == 1 and self.out.connections == 1)

    def another(self) -> Any:
        from surg_ros.byte_topics import BytesSubscriber

        self.made.append(BytesSubscriber(self.topic, self.kind))
        return self.made[-1]

    def wait(self, condition: Callable[[], bool]) -> None:
        self.graph.wait_for(condition, 10.0, "the link")

    def hear(self, subscriber: Any, count: int) -> list[float]:
        """The values of the next messages, at least so many."""
        from surg_ros import link_messages

        heard: list[float] = []

        def enough() -> bool:
            found = [link_messages.unpack_joint_state(data) for data in subscriber.fetch()]
            heard.extend(float(position[0]) for _, position, _ in found)
            return len(heard) >= count

        self.wait(enough)
        return heard

    def close(self) -> None:
        self.out.publisher.unregister()
        for each in self.made:
            each.unregister()


@pytest.fixture
def link(rospy_node: str, ros_graph: RosGraph) -> Iterator[Link]:
    made = Link(ros_graph)
    yield made
    made.close()


def test_every_message_comes_once_in_order(link: Link) -> None:
    for k in range(300):
        link.out.send(packed(k, padding=k % 37))
    assert link.hear(link.first, 300) == list(range(300))
    assert link.first.fetch() == []


def test_the_names_at_both_ends_are_known(link: Link, rospy_node: str) -> None:
    from surg_ros.byte_topics import speakers

    assert link.out.listeners == {rospy_node} == speakers(link.first)


def test_each_of_two_hears_everything_and_keeps_the_newest(link: Link) -> None:
    from surg_ros.byte_topics import _QUEUE

    second = link.another()
    for k in range(_QUEUE + 200):
        link.out.send(packed(k))
        if k % 100 == 99:
            assert link.hear(link.first, 100) == list(range(k - 99, k + 1))
    assert link.hear(second, _QUEUE) == list(range(200, _QUEUE + 200))


def test_one_that_unsubscribes_leaves_the_other_its_messages(link: Link) -> None:
    second = link.another()
    link.out.send(packed(1))
    assert link.hear(link.first, 1) == [1]
    second.unregister()
    link.out.send(packed(2))
    assert link.hear(link.first, 1) == [2] and second.fetch() == []


def test_a_latched_message_reaches_who_comes_later(rospy_node: str, ros_graph: RosGraph) -> None:
    from sensor_msgs.msg import JointState

    from surg_ros.byte_topics import BytesPublisher, BytesSubscriber

    topic = f"/bytes_{next(_names)}"
    out = BytesPublisher(topic, JointState, blocking=False, latch=True)
    out.send(packed(7))
    late = BytesSubscriber(topic, JointState)
    ros_graph.wait_for(lambda: late.fetch() == [packed(7)], 10.0, "the latched message")
    late.unregister()
    out.publisher.unregister()
