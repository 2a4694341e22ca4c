"""A publisher of ready-made bytes that the calling thread writes to the sockets.

rospy's own ``publish`` needs a message object, serialises it, and takes three times as long to
turn ready-made bytes into the same bytes. At 500 Hz that would cost more than the physics.

Off (`switches`): the bytes go through ``rospy.Publisher.publish``.
"""

from __future__ import annotations

import select
import struct
import warnings
from typing import Any

import rospy

from surg_ros.transport import switches

_QUEUE = 10  # messages; plain publisher that does not block


def listeners(publisher: Any) -> set[str]:
    """Names of the nodes that a publisher reaches.

    Whoever waits for a certain node must ask for it by name. A tool that looks at a topic is a
    connection too, and a node can be connected twice: its registration and an update by the master
    may race.
    """
    return {connection.endpoint_id for connection in list(publisher.impl.connections)}


def speakers(subscriber: Any) -> set[str]:
    """Names of the nodes that a subscriber hears."""
    return {connection.callerid_pub for connection in list(subscriber.impl.connections)}


class DirectPublisher:
    """Writes messages to rospy's connections on the calling thread.

    Args:
        topic: Its name.
        kind: Its message class.
        blocking: True: waits for a slow subscriber, so that nothing is lost (lock-step). False: a
            subscriber whose socket is full misses the message, so that none can stop the arm
            (free-run).
        latch: Whether a late subscriber gets the last message.
    """

    def __init__(self, topic: str, kind: type, blocking: bool, latch: bool = False) -> None:
        self._plain = switches.plain("direct_publisher")
        queue = _QUEUE if self._plain and not blocking else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # rospy's hint on queue_size=None
            self.publisher = rospy.Publisher(
                topic, kind, tcp_nodelay=True, queue_size=queue, latch=latch
            )
        self._blocking, self._latch = blocking, latch

    @property
    def connections(self) -> int:
        """How many subscribers are connected."""
        return int(self.publisher.get_num_connections())

    @property
    def listeners(self) -> set[str]:
        """Names of the nodes that subscribe."""
        return listeners(self.publisher)

    def send(self, data: bytes) -> None:
        """Send a message, as on the wire."""
        message = rospy.AnyMsg()
        message._buff = data
        if self._plain:
            self.publisher.publish(message)
            return
        framed = struct.pack("<I", len(data)) + data
        topic = self.publisher.impl
        topic.acquire()
        try:
            if self._latch:
                topic.latch = message
            for connection in topic.connections:
                if self._blocking or _writable(connection.socket):
                    _write(topic, connection, framed)
        finally:
            topic.release()


def _write(topic: Any, connection: Any, framed: bytes) -> None:
    """Send to one subscriber; a closed connection is removed, as rospy does."""
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
    except (OSError, ValueError):  # closed in the meantime
        return False
