"""The socket of the model server: a ROUTER that a stranger can neither fill nor enter.

What ZeroMQ can refuse before it reaches this process is refused there: frames larger than the
protocol's, more than two messages waiting per peer, with keys every peer whose key is not listed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import zmq
from zmq.auth.thread import ThreadAuthenticator

from surg_policy_bridge.server import listen_address
from surg_policy_client import wire
from surg_policy_client.keys import ServerKeys

RCVHWM, SNDHWM = 2, 8
"""Messages that wait for each peer, in and out."""
BACKLOG = 16
AT_ONCE = 32
"""Messages that are taken before there is time for anything else."""
GIVE_WAY = 1e-4
"""[s] Between the parts of a message of thousands."""
DOMAIN = "policy"


def _give_way() -> None:
    """Whoever waits for the processor, a controller above all, goes before a flood.

    A sleep, for `sched_yield` gives way within this process's session only (autogroups).
    """
    time.sleep(GIVE_WAY)


class _AllowList:
    """Which public keys may enter; asked by ZeroMQ before the first message."""

    def __init__(self, keys: Sequence[bytes]) -> None:
        self._keys = frozenset(keys)

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether the owner of this key may enter."""
        return domain == DOMAIN and key in self._keys


class Router:
    """A bound socket.

    Args:
        address: Where to listen.
        keys: Of the server and of those who may enter; None: only on this machine.

    Raises:
        BindError: The address may not be bound, or is taken.
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
            allowed = _AllowList(list(keys.clients.values()))
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
        """What has come, with the peer of each: some of it, the rest later."""
        found = []
        for _ in range(AT_ONCE):
            try:
                peer, *parts = wire.receive(self.socket, zmq.NOBLOCK, _give_way)
            except zmq.Again:
                break
            found.append((bytes(peer.buffer), parts))
        return found

    def send(self, peer: bytes, parts: Sequence[Any]) -> bool:
        """Send; whether it went out: nobody who does not read is waited for."""
        try:
            self.socket.send_multipart([peer, *parts], zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return False
        return True

    def close(self) -> None:
        """Give everything back."""
        if self._guard is not None:
            self._guard.stop()
            self._guard = None
        self.socket.close()
        self._context.term()
