"""The ZeroMQ ROUTER socket of the model server, hardened against unknown peers.

ZeroMQ itself refuses frames larger than the protocol's, more than two waiting messages per peer,
and, with keys, every peer whose key is not listed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import zmq
from zmq.auth.thread import ThreadAuthenticator

from surg_policy_bridge.server import listen_address
from surg_policy_client import wire
from surg_policy_client.keys import ServerKeys

RCVHWM, SNDHWM = 2, 8
"""Queue lengths per peer, in and out."""
BACKLOG = 16
AT_ONCE = 32
"""Messages taken in one call of `receive`."""
YIELD = 1e-4
"""[s] Pause between the parts of a message with thousands of them, above all for the controller. A
sleep, because `sched_yield` yields only to processes of the same autogroup."""
DOMAIN = "policy"


class Router:
    """A bound socket; without keys of the server and its clients for this machine only.

    Raises:
        BindError: The address must not be bound, or is in use.
    """

    def __init__(self, address: str, keys: ServerKeys | None) -> None:
        listen_address.check(address, keys is not None)
        self._context = zmq.Context()
        self._guard: ThreadAuthenticator | None = None
        self.socket = self._context.socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.MAXMSGSIZE, wire.MAX_PART)
        self.socket.setsockopt(zmq.RCVHWM, RCVHWM)
        self.socket.setsockopt(zmq.SNDHWM, SNDHWM)
        self.socket.setsockopt(zmq.BACKLOG, BACKLOG)
        self.socket.setsockopt(zmq.LINGER, 200)
        if keys is not None:
            self._guard = ThreadAuthenticator(self._context)
            self._guard.start()
            public = frozenset(keys.clients.values())
            # ZeroMQ asks before the first message.
            allowed = SimpleNamespace(
                callback=lambda domain, key: domain == DOMAIN and key in public
            )
            self._guard.configure_curve_callback(DOMAIN, allowed)
            self.socket.curve_server = True
            self.socket.zap_domain = DOMAIN.encode()
            self.socket.curve_publickey = keys.public
            self.socket.curve_secretkey = keys.secret
        try:
            self.socket.bind(address)
        except zmq.ZMQError as error:
            self.close()
            raise listen_address.BindError(
                f"address {address!r} cannot be bound: {error.strerror.lower()}; another server "
                "may be running there"
            ) from None

    def receive(self) -> list[tuple[bytes, list[Any]]]:
        """Received messages, at most `AT_ONCE`, with the peer of each."""
        messages = []
        for _ in range(AT_ONCE):
            try:
                peer, *parts = wire.receive(self.socket, zmq.NOBLOCK, lambda: time.sleep(YIELD))
            except zmq.Again:
                break
            messages.append((bytes(peer.buffer), parts))
        return messages

    def send(self, peer: bytes, parts: Sequence[Any]) -> bool:
        """Send without waiting; returns whether it was sent."""
        try:
            self.socket.send_multipart([peer, *parts], zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        if self._guard is not None:
            self._guard.stop()
            self._guard = None
        self.socket.close()
        self._context.term()
