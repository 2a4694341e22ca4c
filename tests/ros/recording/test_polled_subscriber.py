"""A subscriber read by the thread that wants its messages: nothing lost, doubled or held up."""

from __future__ import annotations

import io
import itertools
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace

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
def link(rospy_node: str, ros_graph: RosGraph) -> Iterator[Link]:
    made = Link(ros_graph)
    yield made
    made.close()


class Link:
    """One polled topic and a publisher that waits for a slow subscriber."""

    def __init__(self, graph: RosGraph) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        from surg_ros.transport.polled_subscriber import PolledSubscriber

        self.graph, self.kind = graph, JointState
        self.topic = f"/polled_{next(_names)}"
        self.heard: list[float] = []
        self.polled = PolledSubscriber(self.topic, JointState)
        self.make = lambda: rospy.Publisher(self.topic, JointState, queue_size=None)
        self.publisher = self.make()
        self.wait(lambda: self.polled.get_num_connections() == 1 and self._subscribed())

    def _subscribed(self) -> bool:
        return bool(self.publisher.get_num_connections() == 1)

    def wait(self, condition: Callable[[], bool], what: str = "the link") -> None:
        self.graph.wait_for(condition, 10.0, what)

    def say(self, value: float, padding: int = 0) -> None:
        self.publisher.publish(self.kind(position=[value], effort=[0.0] * padding))

    def hears(self, count: int) -> bool:
        from surg_ros import link_messages

        self.heard += [
            float(link_messages.unpack_joint_state(data)[1][0]) for data in self.polled.fetch()
        ]
        return len(self.heard) >= count

    def close(self) -> None:
        self.publisher.unregister()
        self.polled.subscriber.unregister()


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
