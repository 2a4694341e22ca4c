"""A subscriber that the consuming thread reads directly from the socket.

rospy gives every connection a thread. At 500 Hz each of these threads wakes up for every message
and takes the interpreter lock from the thread that does the work, which costs more than parsing
the message. Here rospy connects, checks the header and finally closes the connection. In between
its thread sleeps, and the consumer reads the socket when it wants the messages.

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
_QUEUE = 1000  # messages that a plain subscriber keeps, the newest ones


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


class PolledSubscriber:
    """A subscriber of small messages that one thread reads."""

    def __init__(self, topic: str, kind: type) -> None:
        self._borrowed: tuple[_BorrowedConnection, ...] = ()
        self._released = False
        self._change = threading.Lock()
        self._queue: deque[bytes] = deque(maxlen=_QUEUE)
        if switches.plain("polled_subscriber"):
            self.subscriber = rospy.Subscriber(
                topic, rospy.AnyMsg, self._on_message, queue_size=None, tcp_nodelay=True
            )
        else:
            TCPROSTransport.receive_loop = _borrow_or_receive
            _POLLED[rospy.resolve_name(topic)] = self
            self.subscriber = rospy.Subscriber(topic, kind, tcp_nodelay=True)

    def _on_message(self, message: rospy.AnyMsg) -> None:
        if not self._released:
            self._queue.append(message._buff)

    def get_num_connections(self) -> int:
        """How many publishers are connected."""
        return int(self.subscriber.get_num_connections())

    def fetch(self) -> list[bytes]:
        """The messages received since the last call, in order for each publisher."""
        messages = [message for borrowed in self._borrowed for message in borrowed.fetch()]
        while self._queue:
            messages.append(self._queue.popleft())
        return messages

    def release(self) -> None:
        """Stop fetching: from now on messages are discarded, so that no publisher blocks.

        Called by the thread that fetched.
        """
        with self._change:
            self._released = True
        for borrowed in self._borrowed:
            borrowed.ended.set()

    def borrow(self, connection: Any) -> None:
        """Sleep while the consumer reads the connection; called by the connection's own thread."""
        borrowed = _BorrowedConnection(connection)
        with self._change:
            if self._released:
                borrowed.ended.set()
            self._borrowed = (*self._borrowed, borrowed)
        while not (borrowed.ended.wait(_WAIT) or connection.done or rospy.is_shutdown()):
            pass
        with self._change:
            self._borrowed = tuple(each for each in self._borrowed if each is not borrowed)
        borrowed.give_back()


_POLLED: dict[str, PolledSubscriber] = {}
_receive_loop = TCPROSTransport.receive_loop


def _borrow_or_receive(connection: Any, callback: Callable[..., None]) -> None:
    """Replaces rospy's receive loop; called by the connection's own thread."""
    polled = _POLLED.get(connection.name)
    if polled is not None and isinstance(connection.protocol, TCPROSSub):
        polled.borrow(connection)
    _receive_loop(connection, callback)
