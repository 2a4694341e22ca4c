"""Subscribers that the consuming threads read directly from the socket.

rospy gives every connection a thread. At 500 Hz each of these threads wakes up for every message
and takes the interpreter lock from the thread that does the work, which costs more than parsing
the message. Here rospy connects, checks the header and finally closes the connection. In between
its thread sleeps, and a consumer reads the socket when it wants the messages. What it reads is
shared: each consumer of the topic in this process has a queue.

Messages wait in the socket until they are fetched, so their time of arrival is unknown.

Off (`switches`): a plain `rospy.Subscriber` whose callback queues the bytes.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import rospy
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_pubsub import TCPROSSub

from surg_ros.transport import switches

MAX_LENGTH = 1 << 20
"""[bytes] A message that claims to be longer is invalid; its connection is closed."""
_CHUNK = 1 << 16
_WAIT = 0.2  # [s] period at which a sleeping thread checks whether the connection was closed
_QUEUE = 1000  # messages that wait for a consumer outside the socket, the newest ones


class FrameDecoder:
    """Splits a byte stream into messages, each preceded by its length. No socket, no clock."""

    def __init__(self, received: bytes = b"") -> None:
        self.rest = received
        """Bytes of messages that are not complete yet."""

    def add(self, data: bytes) -> list[bytes]:
        """The messages that these bytes complete, in order.

        Raises:
            ValueError: A message claims to be longer than `MAX_LENGTH`.
        """
        self.rest += data
        messages, at = [], 0
        while at + 4 <= len(self.rest):
            (length,) = struct.unpack_from("<I", self.rest, at)
            if length > MAX_LENGTH:
                raise ValueError(f"a message of {length} bytes")
            if at + 4 + length > len(self.rest):
                break
            messages.append(self.rest[at + 4 : at + 4 + length])
            at += 4 + length
        self.rest = self.rest[at:]
        return messages


class _BorrowedConnection:
    """One rospy connection that the consumer reads; its own thread waits until it has ``ended``."""

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        # Bytes that arrived together with rospy's handshake come first.
        self.decoder = FrameDecoder(connection.read_buff.getvalue()[: connection.read_buff.tell()])
        connection.read_buff.seek(0)
        connection.read_buff.truncate(0)
        self.ended = threading.Event()

    def fetch(self) -> list[bytes]:
        """The messages received since the last call; none once the connection has ended."""
        link: socket.socket | None = self.connection.socket
        if self.ended.is_set() or link is None:
            return []
        messages: list[bytes] = []
        try:
            messages += self.decoder.add(b"")
            while data := link.recv(_CHUNK, socket.MSG_DONTWAIT):
                messages += self.decoder.add(data)
                if len(data) < _CHUNK:
                    return messages
        except BlockingIOError:
            return messages
        except OSError:
            pass  # closed in the meantime
        except ValueError as error:
            rospy.logwarn(f"{self.connection.name}: {error}; the connection is closed")
            self.connection.close()
        self.ended.set()  # rospy meets the same end, and cleans up
        return messages

    def give_back(self) -> None:
        """Let rospy continue where reading ended; called by the connection's own thread."""
        buffer = self.connection.read_buff
        if buffer is not None:
            buffer.write(self.decoder.rest)


class _Reader:
    """The connections of one topic, read once for all its consumers, each with its own queue."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._borrowed: list[_BorrowedConnection] = []
        self._queues: dict[int, deque[bytes]] = {}  # by id: equal queues are not the same queue

    def add(self, queue: deque[bytes]) -> None:
        """Fill this queue with what arrives from now on; what waits belongs to the others."""
        with self._lock:
            self._share(self._read())
            self._queues[id(queue)] = queue

    def remove(self, queue: deque[bytes]) -> bool:
        """Leave this queue alone; returns whether it was the last one, which ends the reader."""
        with self._lock:
            self._queues.pop(id(queue), None)
            if self._queues:
                return False
            for borrowed in self._borrowed:
                borrowed.ended.set()
            return True

    def fetch(self, queue: deque[bytes]) -> list[bytes]:
        """The messages for this queue's consumer since its last call."""
        with self._lock:
            read = self._read()
            # Not through its queue: who fetches gets all that waited, also more than `_QUEUE`.
            messages = [*queue, *read]
            self._share(read)
            queue.clear()
            return messages

    def _read(self) -> list[bytes]:
        return [message for borrowed in self._borrowed for message in borrowed.fetch()]

    def _share(self, messages: list[bytes]) -> None:
        for queue in self._queues.values():
            queue.extend(messages)

    def borrow(self, connection: Any) -> None:
        """Sleep while the consumers read the connection; called by the connection's own thread."""
        borrowed = _BorrowedConnection(connection)
        with self._lock:
            if not self._queues:  # the last consumer left in the meantime
                borrowed.ended.set()
            self._borrowed.append(borrowed)
        while not (borrowed.ended.wait(_WAIT) or connection.done or rospy.is_shutdown()):
            pass
        with self._lock:
            self._borrowed.remove(borrowed)
        borrowed.give_back()


class PolledSubscriber:
    """A consumer of small messages; one thread fetches them.

    A process may have several of a topic. Each gets every message from the moment it subscribes,
    and keeps the newest 1000 of those that another one has read for it. From a connection that
    rospy is still making it may get earlier ones. A `rospy.Subscriber` of the topic in the same
    process hears nothing.

    Args:
        topic: Its name.
        kind: Its message class; the first subscriber of a topic decides.

    Raises:
        ValueError: The topic has no name, the kind is no message class, or the environment names an
            unknown optimisation (`switches`).
    """

    def __init__(self, topic: str, kind: type) -> None:
        self._queue: deque[bytes] = deque(maxlen=_QUEUE)
        self._reader: _Reader | None = None
        self._released = False
        if switches.plain("polled_subscriber"):
            self.subscriber = rospy.Subscriber(
                topic, rospy.AnyMsg, self._on_message, queue_size=None, tcp_nodelay=True
            )
            return
        TCPROSTransport.receive_loop = _borrow_or_receive
        self._name = rospy.resolve_name(topic)
        with _change:
            self._reader = _POLLED.setdefault(self._name, _Reader())
            self._reader.add(self._queue)
            # rospy counts these: all of a topic share its connections.
            self.subscriber = rospy.Subscriber(topic, kind, tcp_nodelay=True)

    def _on_message(self, message: rospy.AnyMsg) -> None:
        self._queue.append(message._buff)

    def get_num_connections(self) -> int:
        """How many publishers are connected; none after `release`."""
        return 0 if self._released else int(self.subscriber.get_num_connections())

    def fetch(self) -> list[bytes]:
        """The messages received since the last call, in order for each publisher.

        Empty after `release`.
        """
        if self._released:
            return []
        if self._reader is not None:
            return self._reader.fetch(self._queue)
        messages = []
        while self._queue:
            messages.append(self._queue.popleft())
        return messages

    def release(self) -> None:
        """Unsubscribe; the last one of a topic closes its connections, so no publisher waits.

        Called by the thread that fetched. A second call has no effect.
        """
        with _change:
            if self._released:
                return
            self._released = True
            if self._reader is not None and self._reader.remove(self._queue):
                del _POLLED[self._name]
            self.subscriber.unregister()


_POLLED: dict[str, _Reader] = {}
_change = threading.Lock()
"""Held while a consumer comes or goes: one that comes while the last one goes would get that one's
connections from rospy, and nobody reads these any more."""
_receive_loop = TCPROSTransport.receive_loop


def _borrow_or_receive(connection: Any, callback: Callable[..., None]) -> None:
    """Replaces rospy's receive loop; called by the connection's own thread."""
    reader = _POLLED.get(connection.name)
    if reader is not None and isinstance(connection.protocol, TCPROSSub):
        reader.borrow(connection)
    _receive_loop(connection, callback)
