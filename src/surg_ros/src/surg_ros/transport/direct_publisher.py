"""How the messages of every tick are sent and received: as bytes, on the thread that has them.

Building, queueing and parsing message objects at 500 Hz would cost more than the physics.
"""

from __future__ import annotations

import select
import struct
import warnings
from typing import Any

import rospy
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState

from surg_recording.nodes.raw_message import RawMessage


class RawJointState(RawMessage, JointState):  # type: ignore[misc]
    """A JointState that keeps its bytes; ``wire`` reads what the bridge needs of them."""


class RawTwist(RawMessage, TwistStamped):  # type: ignore[misc]
    """A TwistStamped that keeps its bytes."""


def listeners(publisher: Any) -> set[str]:
    """Names of the nodes that a publisher reaches.

    Who waits for a certain node must ask for it by name: a tool that looks at a topic is a
    connection too, and a node can be connected twice (its registration and an update by the master
    may race).
    """
    return {connection.endpoint_id for connection in list(publisher.impl.connections)}


def speakers(subscriber: Any) -> set[str]:
    """Names of the nodes that a subscriber hears."""
    return {connection.callerid_pub for connection in list(subscriber.impl.connections)}


class Output:
    """A publisher of ready-made bytes, sent by the calling thread.

    It writes to rospy's connections itself: rospy's own ``publish`` spends three times as long on
    turning bytes into the same bytes.

    Args:
        topic: Its name.
        kind: Its message class.
        patient: True: waits for a slow subscriber, nothing is ever lost (lock-step). False: a
            subscriber whose socket is full misses the message, so that none can stop the arm
            (free-run).
        latch: Whether a late subscriber gets the last message.
    """

    def __init__(self, topic: str, kind: type, patient: bool, latch: bool = False) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # rospy's hint on queue_size=None
            self.publisher = rospy.Publisher(
                topic, kind, tcp_nodelay=True, queue_size=None, latch=latch
            )
        self._patient, self._latch = patient, latch

    @property
    def connections(self) -> int:
        """How many subscribers are connected."""
        return int(self.publisher.get_num_connections())

    @property
    def listeners(self) -> set[str]:
        """Names of the nodes that subscribe."""
        return listeners(self.publisher)

    def send(self, data: bytes) -> None:
        """Send a message."""
        framed = struct.pack("<I", len(data)) + data
        topic = self.publisher.impl
        topic.acquire()
        try:
            if self._latch:
                topic.latch = rospy.AnyMsg()
                topic.latch._buff = data
            for connection in topic.connections:
                if self._patient or _writable(connection.socket):
                    _write(topic, connection, framed)
        finally:
            topic.release()


def _write(topic: Any, connection: Any, framed: bytes) -> None:
    """Send to one subscriber; one that has gone is forgotten, as rospy does."""
    try:
        connection.write_data(framed)
    except (OSError, rospy.exceptions.TransportException):
        if not rospy.is_shutdown():
            connection.close()
            topic.remove_connection(connection)


def _writable(socket: Any) -> bool:
    """Whether a socket takes a small message at once (a third of its buffer is free)."""
    try:
        return socket is not None and bool(select.select((), (socket,), (), 0)[1])
    except (OSError, ValueError):  # closed meanwhile
        return False
