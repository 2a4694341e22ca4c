"""Subscribers read by the threads that want the messages: nothing lost, doubled or held up."""

from __future__ import annotations

import io
import itertools
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph

pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore:The publisher should be")]

_names = itertools.count()


def framed(message: bytes) -> bytes:
    return struct.pack("<I", len(message)) + message


def test_messages_come_out_of_any_pieces() -> None:
    from surg_ros.transport.polled_subscriber import FrameDecoder

    pieces_seen = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        messages = [rng.bytes(int(n)) for n in rng.integers(0, 300, 20)]
        stream = b"".join(map(framed, messages))
        cuts = sorted(rng.integers(0, len(stream), rng.integers(0, 60)).tolist())
        pieces = [stream[a:b] for a, b in itertools.pairwise([0, *cuts, len(stream)])]
        head = int(rng.integers(0, len(pieces)))
        frames = FrameDecoder(b"")
        found = [m for piece in pieces[:head] for m in frames.add(piece)]
        later = FrameDecoder(frames.rest)  # as another reader would go on
        found += [m for piece in pieces[head:] for m in later.add(piece)]
        assert found == messages and later.rest == b""
        pieces_seen += len(pieces)
    print(f"{pieces_seen} pieces")


def test_a_length_that_cannot_be_is_no_message() -> None:
    from surg_ros.transport.polled_subscriber import MAX_LENGTH, FrameDecoder

    assert FrameDecoder().add(framed(bytes(MAX_LENGTH)))
    with pytest.raises(ValueError, match="a message of"):
        FrameDecoder().add(struct.pack("<I", MAX_LENGTH + 1))


def test_nonsense_that_comes_with_the_handshake_ends_the_connection_and_nothing_else() -> None:
    from surg_ros.transport.polled_subscriber import _BorrowedConnection

    buffer, closed = io.BytesIO(), []
    buffer.write(framed(b"first") + b"\xff" * 8)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        connection = SimpleNamespace(
            read_buff=buffer, socket=ours, name="topic", close=lambda: closed.append(True)
        )
        lent = _BorrowedConnection(connection)
        lent.fetch()
        assert closed and lent.ended.is_set() and lent.fetch() == []


@pytest.fixture
def link(
    rospy_node: str,
    ros_graph: RosGraph,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Link]:
    monkeypatch.setenv("SURG_PLAIN_ROS", getattr(request, "param", ""))
    made = Link(ros_graph)
    yield made
    made.close()


with_and_without = pytest.mark.parametrize("link", ["", "polled_subscriber"], indirect=True)
"""The optimisation on, and off."""


def values(polled: Any) -> list[float]:
    from surg_ros import link_messages

    return [float(link_messages.unpack_joint_state(data)[1][0]) for data in polled.fetch()]


class Link:
    """One polled topic and a publisher that waits for a slow subscriber."""

    def __init__(self, graph: RosGraph) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        self.graph, self.kind = graph, JointState
        self.topic = f"/polled_{next(_names)}"
        self.heard: list[float] = []
        self.made: list[Any] = []
        self.polled = self.another()
        self.make = lambda: rospy.Publisher(self.topic, JointState, queue_size=None)
        self.publisher = self.make()
        self.wait(lambda: self.polled.get_num_connections() == 1 and self._subscribed())

    def another(self) -> Any:
        from surg_ros.transport.polled_subscriber import PolledSubscriber

        self.made.append(PolledSubscriber(self.topic, self.kind))
        return self.made[-1]

    def restart(self) -> None:
        """Another publisher in the place of the first, which has ended before.

        In one process both have the same address, and rospy connects to no address twice.
        """
        self.publisher.unregister()
        self.wait(self._alone, "the end of the first publisher")
        self.publisher = self.make()
        self.wait(self._subscribed, "the second publisher")

    def _alone(self) -> bool:
        return not any(each.fetch() or each.get_num_connections() for each in self.made)

    def _subscribed(self) -> bool:
        return bool(self.publisher.get_num_connections() == 1)

    def wait(self, condition: Callable[[], bool], what: str = "the link") -> None:
        self.graph.wait_for(condition, 10.0, what)

    def say(self, value: float, padding: int = 0) -> None:
        self.publisher.publish(self.kind(position=[value], effort=[0.0] * padding))

    def hears(self, count: int) -> bool:
        self.heard += values(self.polled)
        return len(self.heard) >= count

    def heard_by(self, *consumers: Any) -> None:
        """Each of them hears a value said from now on."""
        deaf = list(consumers)

        def all_hear() -> bool:
            self.say(77.0)
            deaf[:] = [each for each in deaf if 77.0 not in values(each)]
            return not deaf

        self.wait(all_hear, "every consumer")

    def close(self) -> None:
        self.publisher.unregister()
        for each in self.made:
            each.release()


def test_every_message_comes_once_in_order_and_only_when_it_is_asked_for(link: Link) -> None:
    for k in range(300):
        link.say(k, padding=k % 37)
    assert link.heard == []
    link.wait(lambda: link.hears(300))
    assert link.polled.fetch() == []
    assert link.heard == list(range(300))


def test_a_plain_subscriber_delivers_the_same(
    rospy_node: str, ros_graph: RosGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the optimisation off, and a plain publisher of ready-made bytes on the other side."""
    from sensor_msgs.msg import JointState

    from surg_ros.transport.direct_publisher import DirectPublisher

    monkeypatch.setenv("SURG_PLAIN_ROS", "all")
    link = Link(ros_graph)
    output = DirectPublisher(link.topic, JointState, blocking=True)
    link.wait(lambda: output.connections == 1)
    assert link.polled.subscriber.impl.data_class.__name__ == "AnyMsg"
    for k in range(300):
        buffer = io.BytesIO()
        JointState(position=[k], effort=[0.0] * (k % 37)).serialize(buffer)
        output.send(buffer.getvalue())
    link.wait(lambda: link.hears(300))
    assert link.heard == list(range(300)) and link.polled.fetch() == []
    link.polled.release()
    link.say(1)
    output.publisher.unregister()
    link.close()


def test_a_sender_that_goes_is_forgotten_and_the_next_is_heard(link: Link) -> None:
    link.say(1)
    link.wait(lambda: link.hears(1))
    link.publisher.unregister()
    link.publisher = link.make()

    def heard_again() -> bool:
        link.say(2)
        return link.hears(2)

    link.wait(heard_again, "the second sender")
    link.wait(lambda: link.polled.get_num_connections() == 1, "one connection")
    assert set(link.heard) == {1, 2}


def test_nobody_waits_for_a_tick_that_never_comes(link: Link) -> None:
    """Free-run has ended: a sender that waits for its subscriber is not held up."""
    link.say(1)
    link.wait(lambda: link.hears(1))
    link.polled.release()
    sent = threading.Event()

    def flood() -> None:
        for k in range(400):
            link.say(k, padding=5000)  # 16 MB: more than sockets hold
        sent.set()

    threading.Thread(target=flood, daemon=True).start()
    assert sent.wait(20.0)
    assert link.polled.fetch() == []


def test_a_sender_of_nonsense_is_cut_off(link: Link) -> None:
    link.say(1)
    link.wait(lambda: link.hears(1))
    (connection,) = link.publisher.impl.connections
    connection = getattr(connection, "_connection", connection)
    connection.socket.sendall(b"\xff" * 64)
    link.wait(lambda: link.hears(1) and link.polled.get_num_connections() == 0, "the end")
    assert link.heard == [1]


def test_each_of_two_hears_everything_from_the_moment_it_subscribes(link: Link) -> None:
    link.say(0)
    link.wait(lambda: link.hears(1))  # rospy's thread has handed the connection over
    for k in range(1, 10):
        link.say(k)
    second = link.another()
    for k in range(10, 20):
        link.say(k)
    link.wait(lambda: link.hears(20))
    assert link.heard == list(range(20))
    assert values(second) == list(range(10, 20)) and link.polled.fetch() == second.fetch() == []


def test_who_does_not_fetch_keeps_the_newest_and_takes_none_from_the_other(link: Link) -> None:
    from surg_ros.transport.polled_subscriber import _QUEUE

    second = link.another()
    for k in range(_QUEUE + 200):
        link.say(k)
        link.hears(k)
    link.wait(lambda: link.hears(_QUEUE + 200))
    assert link.heard == list(range(_QUEUE + 200))
    assert values(second) == list(range(200, _QUEUE + 200))


def test_two_threads_fetch_beside_consumers_that_come_and_go(link: Link) -> None:
    second, count = link.another(), 500
    found: list[float] = []

    def fetch() -> None:
        while len(found) < count:
            found.extend(values(second))

    thread = threading.Thread(target=fetch, daemon=True)
    thread.start()
    for k in range(count):
        passing = link.another() if k % 10 == 0 else None
        link.say(k)
        link.hears(k)
        if passing is not None:
            passing.release()
    link.wait(lambda: link.hears(count))
    thread.join(10.0)
    assert link.heard == found == list(range(count))


@with_and_without
def test_one_that_is_released_leaves_the_other_its_messages(link: Link) -> None:
    second = link.another()
    link.heard_by(link.polled, second)
    second.release()
    second.release()  # once more is no error
    link.heard_by(link.polled)
    assert second.fetch() == [] and second.get_num_connections() == 0
    link.restart()
    link.heard_by(link.polled)
    assert second.fetch() == []


@with_and_without
def test_a_publisher_that_restarts_is_heard_by_all(link: Link) -> None:
    second = link.another()
    link.heard_by(link.polled, second)
    link.restart()
    link.heard_by(link.polled, second)


@with_and_without
def test_after_the_last_one_the_next_starts_fresh(link: Link) -> None:
    from surg_ros.transport.polled_subscriber import _POLLED

    second = link.another()
    link.heard_by(link.polled, second)
    link.say(1)
    link.polled.release()
    second.release()
    link.wait(lambda: link.publisher.get_num_connections() == 0, "the end of the subscription")
    assert link.topic not in _POLLED
    third = link.another()
    second.release()  # has no part in the new one
    assert third.fetch() == []
    link.heard_by(third)
    assert second.fetch() == link.polled.fetch() == []
    link.restart()
    link.heard_by(third)
