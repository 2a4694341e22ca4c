"""Topics whose messages stay bytes: small ones at 500 Hz, which struct packs and unpacks."""

from __future__ import annotations

import functools
import socket
import struct
import time
import warnings
from collections import deque
from typing import Any

import rospy

from surg_core.contract import GRID

_QUEUE = 1000  # messages that wait for `BytesSubscriber.fetch`, the newest ones
_TOGETHER = 0.001  # [s] messages of one receipt follow each other sooner
_WAITING = 10  # messages that wait for a slow subscriber of a latched publisher


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


@functools.cache
def as_bytes(kind: type) -> type:
    """A message class with the same checksum whose subscriber gets the bytes, as ``data``."""

    def deserialize(self: Any, data: bytes) -> Any:
        self.data = data
        return self

    # Without `kind`'s own __init__, which would make members that are never filled.
    members = {"__init__": lambda self: None, "data": b"", "deserialize": deserialize}
    return type(f"{kind.__name__}Bytes", (kind,), members)


@functools.cache
def on_grid(kind: type) -> type:
    """A message class with the same checksum that is read on the grid only.

    Its first members are a header and a ``tick``, which is all that is known of others.
    """

    def deserialize(self: Any, data: bytes) -> Any:
        (frame,) = struct.unpack_from("<I", data, 12)
        (self.tick,) = struct.unpack_from("<Q", data, 16 + frame)
        if self.tick % GRID:
            return self
        kind.__init__(self)  # type: ignore[misc]
        return kind.deserialize(self, data)  # type: ignore[attr-defined]

    members = {"__init__": lambda self: None, "deserialize": deserialize}
    return type(f"{kind.__name__}OnGrid", (kind,), members)


class BytesPublisher:
    """Publishes messages that are bytes already.

    Args:
        topic: Its name.
        kind: Its message class.
        blocking: True: waits for a slow subscriber, so that nothing is lost (lock-step). False: a
            slow subscriber misses messages, so that none can stop the arm (free-run).
        latch: Whether a late subscriber gets the last message.
    """

    def __init__(self, topic: str, kind: type, blocking: bool, latch: bool = False) -> None:
        self._blocking, self._latch = blocking, latch
        queue = _WAITING if latch and not blocking else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # rospy's hint on queue_size=None
            self.publisher = rospy.Publisher(
                topic, kind, tcp_nodelay=True, queue_size=queue, latch=latch
            )
        self._unsent: dict[Any, bytes] = {}  # the rest of a message, by connection

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
        if self._latch:
            message = rospy.AnyMsg()
            message._buff = data
            self.publisher.publish(message)
            return
        # rospy's queue wakes a thread for each subscriber and message: 0.4 of a core at 500 Hz.
        frame = struct.pack("<I", len(data)) + data
        implementation = self.publisher.impl
        for connection in [] if implementation is None else implementation.connections:
            try:
                if self._blocking:
                    connection.socket.sendall(frame)
                else:
                    self._offer(connection, frame)
            except (OSError, AttributeError):  # it has gone
                implementation.remove_connection(connection)
                connection.close()

    def _offer(self, connection: Any, frame: bytes) -> None:
        """Give a subscriber's socket what it takes at once."""
        rest = _left(connection.socket, self._unsent.pop(connection, b""))
        if not rest:
            rest = _left(connection.socket, frame)
            rest = rest if len(rest) < len(frame) else b""
        if rest:  # a message that has begun is sent to its end
            self._unsent[connection] = rest


def _left(connected: socket.socket, data: bytes) -> bytes:
    """What of these bytes a socket does not take at once."""
    try:
        return data[connected.send(data, socket.MSG_DONTWAIT) :] if data else data
    except BlockingIOError:
        return data


class Pause:
    """Lets a connection's messages wait in its socket, so that its thread takes many at once.

    A thread that wakes for each of 500 messages a second costs 0.02 of a core. Call it, in that
    thread, after each message; it pauses [s] once in each receipt.
    """

    def __init__(self, pause: float) -> None:
        self._pause, self._paused = pause, -_TOGETHER

    def __call__(self) -> None:
        """A message has been taken."""
        if self._pause and time.monotonic() - self._paused > _TOGETHER:
            time.sleep(self._pause)
            self._paused = time.monotonic()


class BytesSubscriber:
    """Keeps the bytes of a topic's messages until its owner fetches them.

    rospy gives all subscribers of a topic in a process the class of the first one: a plain
    `rospy.Subscriber` beside this one gets no values.

    Args:
        topic: Its name.
        kind: Its message class.
        pause: So long [s] what comes waits in the socket, see `Pause`.
    """

    def __init__(self, topic: str, kind: type, pause: float = 0.0) -> None:
        self._queue: deque[bytes] = deque(maxlen=_QUEUE)
        self._pause = Pause(pause)
        self.subscriber = rospy.Subscriber(topic, as_bytes(kind), self._keep, tcp_nodelay=True)

    def _keep(self, message: Any) -> None:
        self._queue.append(message.data)
        self._pause()

    @property
    def impl(self) -> Any:
        """Rospy's connections, for `speakers`."""
        return self.subscriber.impl

    def get_num_connections(self) -> int:
        """How many publishers are connected."""
        return int(self.subscriber.get_num_connections())

    def fetch(self) -> list[bytes]:
        """The messages received since the last call, the newest 1000, in order."""
        messages = []
        while self._queue:
            messages.append(self._queue.popleft())
        return messages

    def unregister(self) -> None:
        """Unsubscribe; what waits is dropped."""
        self.subscriber.unregister()
        self._queue.clear()
