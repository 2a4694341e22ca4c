"""A subscriber whose messages are fetched by the thread that wants them, when it wants them.

rospy gives every connection a thread. At 500 Hz each of them wakes up for every message and takes
the interpreter from the thread that works, which costs more than reading the message. Here rospy
connects, checks and, in the end, closes the connection; in between its thread sleeps, and whoever
wants the messages looks into the socket.

Mind that a message waits in the socket until it is fetched: when it came is not known.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable
from typing import Any

import rospy
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_pubsub import TCPROSSub

MOST = 1 << 20
"""Bytes. What says that it is longer is no message, and its connection is closed."""
_CHUNK = 1 << 16
_WAIT = 0.2  # [s] between two looks of a sleeping thread whether the connection was closed


class Frames:
    """Messages out of a stream of bytes: each has its length in front. No socket, no clock."""

    def __init__(self, begun: bytes = b"") -> None:
        self.rest = begun
        """What has come of messages that are not complete."""

    def add(self, data: bytes) -> list[bytes]:
        """The messages that are complete with these bytes, in order.

        Raises:
            ValueError: A message says that it is longer than `MOST`.
        """
        self.rest += data
        found, at = [], 0
        while at + 4 <= len(self.rest):
            (length,) = struct.unpack_from("<I", self.rest, at)
            if length > MOST:
                raise ValueError(f"a message of {length} bytes")
            if at + 4 + length > len(self.rest):
                break
            found.append(self.rest[at + 4 : at + 4 + length])
            at += 4 + length
        self.rest = self.rest[at:]
        return found


class _Lent:
    """One connection while it is read here.

    Args:
        connection: Of rospy, connected; its thread waits until ``ended`` is set.
    """

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        # What has come with rospy's handshake is the beginning.
        self.frames = Frames(connection.read_buff.getvalue()[: connection.read_buff.tell()])
        connection.read_buff.seek(0)
        connection.read_buff.truncate(0)
        self.ended = threading.Event()

    def fetch(self) -> list[bytes]:
        """What has come; after the end of the connection nothing, and rospy has it back."""
        link: socket.socket | None = self.connection.socket
        if self.ended.is_set() or link is None:
            return []
        found: list[bytes] = []
        try:
            found += self.frames.add(b"")
            while data := link.recv(_CHUNK, socket.MSG_DONTWAIT):
                found += self.frames.add(data)
                if len(data) < _CHUNK:
                    return found
        except BlockingIOError:
            return found
        except OSError:
            pass  # closed meanwhile
        except ValueError as error:
            rospy.logwarn(f"{self.connection.name}: {error}; the connection is closed")
            self.connection.close()
        self.ended.set()  # rospy meets the same end, and tidies up
        return found

    def give_back(self) -> None:
        """In the connection's own thread: rospy goes on where reading has ended."""
        buffer = self.connection.read_buff
        if buffer is not None:
            buffer.write(self.frames.rest)


class Polled:
    """A subscriber of small messages that is read by one thread.

    Args:
        topic: Its name.
        kind: Its message class.
    """

    def __init__(self, topic: str, kind: type) -> None:
        self._lent: tuple[_Lent, ...] = ()
        self._over = False
        self._change = threading.Lock()
        _POLLED[rospy.resolve_name(topic)] = self
        self.subscriber = rospy.Subscriber(topic, kind, tcp_nodelay=True)

    def get_num_connections(self) -> int:
        """How many publishers are connected."""
        return int(self.subscriber.get_num_connections())

    def fetch(self) -> list[bytes]:
        """The messages that have come since the last time, each sender's in order."""
        return [message for lent in self._lent for message in lent.fetch()]

    def release(self) -> None:
        """Nobody will fetch any more: what comes is forgotten, so that no sender waits.

        Called by the thread that has fetched.
        """
        with self._change:
            self._over = True
        for lent in self._lent:
            lent.ended.set()

    def lend(self, connection: Any) -> None:
        """The connection's own thread: sleep while the connection is read here."""
        lent = _Lent(connection)
        with self._change:
            if self._over:
                lent.ended.set()
            self._lent = (*self._lent, lent)
        while not (lent.ended.wait(_WAIT) or connection.done or rospy.is_shutdown()):
            pass
        with self._change:
            self._lent = tuple(each for each in self._lent if each is not lent)
        lent.give_back()


_POLLED: dict[str, Polled] = {}
_receive_loop = TCPROSTransport.receive_loop


def _lend_or_receive(connection: Any, callback: Callable[..., None]) -> None:
    """In place of rospy's loop, in the connection's own thread."""
    polled = _POLLED.get(connection.name)
    if polled is not None and isinstance(connection.protocol, TCPROSSub):
        polled.lend(connection)
    _receive_loop(connection, callback)


TCPROSTransport.receive_loop = _lend_or_receive
