"""A ROS 2 process as a caller of ROS 1: a node of its own for each one that sends commands.

Authority over an arm goes by the caller's name, so two ROS 2 processes must not share one. The node
is a child process, which ends when the ROS 2 process has gone.
"""

from __future__ import annotations

import multiprocessing
import select
import signal
import socket
import threading
import time
from multiprocessing import forkserver

import roslib.message
import rospy

from surg_ros.byte_topics import BytesPublisher

LARGEST = 65536
"""[bytes] Of a command; a larger one is no command."""
PATIENCE = 4.0
"""[s] How long a first command waits for the connection to the controller."""
_LOOK = 0.005
"""[s] How often a command that waits looks for it."""
_TOPIC, _COMMAND = b"+", b"!"
"""What a frame holds: a topic and its type, or a topic and a message; a zero lies between."""


class Caller:
    """One ROS 2 process, seen from the gateway.

    Args:
        name: Of the node, without a namespace.
        context: That makes the processes, of `forked`.
        blocking: Whether nothing may be lost (lock-step).
    """

    def __init__(
        self, name: str, context: multiprocessing.context.ForkServerContext, blocking: bool
    ) -> None:
        self.name = name
        self.lost = 0
        """Commands that the node was too slow for."""
        self._topics: set[str] = set()
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setblocking(False)
        process = context.Process(target=run, args=(name, theirs, blocking), daemon=True)

        def start() -> None:
            process.start()
            theirs.close()  # the child's is a copy: ours would hide that it has ended

        # The other senders do not wait for this one; its commands wait in the socket.
        threading.Thread(target=start, daemon=True).start()

    def announce(self, topic: str, kind: str) -> None:
        """It will send commands on this topic."""
        if topic not in self._topics:
            self._topics.add(topic)
            self._send(_TOPIC + topic.encode() + b"\0" + kind.encode())

    def send(self, topic: str, message: bytes) -> None:
        """It has sent a command; ``message`` as ROS 1 has it on the wire."""
        self._send(_COMMAND + topic.encode() + b"\0" + message)

    def close(self) -> None:
        """It has gone."""
        self._socket.close()

    def _send(self, frame: bytes) -> None:
        try:
            self._socket.send(frame)
        except OSError:  # full, too large, or the node has ended
            self.lost += 1


def forked() -> multiprocessing.context.ForkServerContext:
    """Makes processes in 50 ms, from one that has imported everything and has no threads.

    That one is started here: the first sender's commands would wait 0.4 s for it.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    forkserver.ensure_running()
    return context


def run(name: str, commands: socket.socket, blocking: bool) -> None:
    """The child process: publish what comes, until the gateway closes its end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rospy.init_node(name, disable_signals=True)
    try:
        _serve(commands, blocking)
    finally:
        rospy.signal_shutdown("the ROS 2 process has gone")


def _serve(commands: socket.socket, blocking: bool) -> None:
    publishers: dict[str, BytesPublisher] = {}
    waiting: list[tuple[float, str, bytes]] = []
    while not rospy.is_shutdown():
        if select.select([commands], [], [], _LOOK if waiting else 1.0)[0]:
            frame = commands.recv(LARGEST * 2)
            if not frame:
                return
            topic, _, rest = frame[1:].partition(b"\0")
            name = topic.decode()
            if frame[:1] == _TOPIC:
                kind = roslib.message.get_message_class(rest.decode())
                publishers[name] = BytesPublisher(name, kind, blocking)
            else:
                waiting.append((time.monotonic(), name, rest))
        late: list[tuple[float, str, bytes]] = []
        for came, name, message in waiting:
            if publishers[name].connections:
                publishers[name].send(message)
            elif blocking or time.monotonic() - came < PATIENCE:
                late.append((came, name, message))
            else:
                rospy.logwarn_once(f"ros2: {name}: nobody was connected; a command was dropped")
        waiting = late
