"""Topics that stay bytes: nothing lost, doubled or mixed up between consumers of one process."""

from __future__ import annotations

import io
import itertools
import socket
import struct
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph

pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore:The publisher should be")]

_names = itertools.count()


def packed(value: float, padding: int = 0) -> bytes:
    from sensor_msgs.msg import JointState

    buffer = io.BytesIO()
    JointState(position=[value], effort=[0.0] * padding).serialize(buffer)
    return buffer.getvalue()


def _value(data: bytes) -> float:
    from surg_ros import link_messages

    return float(link_messages.unpack_joint_state(data)[1][0])


class Link:
    """A topic with a publisher of bytes and one subscriber, of as many as a test wants."""

    def __init__(self, graph: RosGraph, blocking: bool, pause: float = 0.0) -> None:
        from sensor_msgs.msg import JointState

        from surg_ros.byte_topics import BytesPublisher

        self.graph, self.kind = graph, JointState
        self.topic = f"/bytes_{next(_names)}"
        self.made: list[Any] = []
        self.first = self.another(pause)
        self.out = BytesPublisher(self.topic, JointState, blocking)
        self.wait(lambda: self.first.get_num_connections() == 1 and self.out.connections == 1)

    def another(self, pause: float = 0.0) -> Any:
        from surg_ros.byte_topics import BytesSubscriber

        self.made.append(BytesSubscriber(self.topic, self.kind, pause))
        return self.made[-1]

    def wait(self, condition: Callable[[], bool]) -> None:
        self.graph.wait_for(condition, 10.0, "the link")

    def hear(self, subscriber: Any, count: int) -> list[float]:
        """The values of the next messages, at least so many."""
        heard: list[float] = []

        def enough() -> bool:
            heard.extend(map(_value, subscriber.fetch()))
            return len(heard) >= count

        self.wait(enough)
        return heard

    def close(self) -> None:
        self.out.publisher.unregister()
        for each in self.made:
            each.unregister()


@pytest.fixture(params=[True, False], ids=["waits", "offers"])
def link(request: pytest.FixtureRequest, rospy_node: str, ros_graph: RosGraph) -> Iterator[Link]:
    made = Link(ros_graph, request.param)
    yield made
    made.close()


def test_every_message_comes_once_in_order(link: Link) -> None:
    for k in range(300):
        link.out.send(packed(k, padding=k % 37))
    assert link.hear(link.first, 300) == list(range(300))
    assert link.first.fetch() == []


def test_who_pauses_takes_many_messages_at_once_and_misses_none(
    rospy_node: str, ros_graph: RosGraph
) -> None:
    link = Link(ros_graph, False, pause=0.05)
    try:
        values, receipts = [], 0
        for k in range(500):
            link.out.send(packed(k))
            time.sleep(0.002)
            heard = link.first.fetch()
            values += [_value(data) for data in heard]
            receipts += bool(heard)
        values += link.hear(link.first, 500 - len(values))
        assert values == list(range(500))
        assert 3 <= receipts <= 100, "a second has 20 pauses, with a message before each"
    finally:
        link.close()


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


def connected() -> tuple[socket.socket, socket.socket]:
    """Both ends of a connection by TCP, which takes parts of a message."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        far = socket.socket()
        far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        far.connect(server.getsockname())
        return server.accept()[0], far


class Connection:
    """What a publisher has of rospy for each subscriber."""

    def __init__(self, near: socket.socket) -> None:
        self.socket, self.close = near, near.close


class Ears:
    """Subscribers' ends of a publisher that has no graph."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, count: int, blocking: bool = False) -> None:
        from sensor_msgs.msg import JointState

        from surg_ros import byte_topics

        pairs = [connected() for _ in range(count)]
        for near, far in pairs:
            near.setblocking(True)  # as rospy leaves them behind the header
            near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            far.settimeout(0.0)
        self.far = [far for _, far in pairs]
        self.heard = [b""] * count
        self.impl = SimpleNamespace(
            connections=[Connection(near) for near, _ in pairs],
            remove_connection=lambda gone: setattr(
                self.impl, "connections", [c for c in self.impl.connections if c is not gone]
            ),
        )
        made = SimpleNamespace(impl=self.impl)
        monkeypatch.setattr(byte_topics.rospy, "Publisher", lambda *_, **__: made)
        self.out = byte_topics.BytesPublisher("/t", JointState, blocking)

    def read(self, which: int, most: int = 1 << 20) -> None:
        try:
            self.heard[which] += self.far[which].recv(most)
        except BlockingIOError:
            return

    def messages(self, which: int) -> list[bytes]:
        """What has come, whole; the wire's lengths must lead from one to the next."""
        found, at, heard = [], 0, self.heard[which]
        while at < len(heard):
            end = at + 4 + struct.unpack_from("<I", heard, at)[0]
            assert end <= len(heard), "a message was cut"
            found.append(heard[at + 4 : end])
            at = end
        return found


def test_a_slow_subscriber_misses_whole_messages_and_delays_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ears, rng = Ears(monkeypatch, 2), np.random.default_rng(0)
    sent = [bytes(rng.integers(0, 256, rng.integers(1, 3000), np.uint8)) for _ in range(400)]
    for k, message in enumerate(sent):
        ears.out.send(message)
        ears.read(0)
        if k % 7 == 0:
            ears.read(1, int(rng.integers(1, 5000)))
    for _ in range(400):  # what had begun is sent to its end, with the next messages
        ears.out.send(b"end")
        ears.read(0)
        ears.read(1)
    assert ears.messages(0)[:400] == sent
    some = [message for message in ears.messages(1) if message != b"end"]
    kept = [sent.index(message) for message in some]
    assert kept == sorted(set(kept)) and 20 < len(kept) < 400


@pytest.mark.parametrize("blocking", [False, True])
def test_one_that_has_gone_is_forgotten(monkeypatch: pytest.MonkeyPatch, blocking: bool) -> None:
    ears = Ears(monkeypatch, 2, blocking)
    ears.far[1].close()
    for k in range(3):
        ears.out.send(bytes([k]))
        ears.read(0)
    assert len(ears.impl.connections) == 1 and ears.messages(0) == [b"\0", b"\1", b"\2"]
