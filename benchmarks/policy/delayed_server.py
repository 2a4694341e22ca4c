"""A model server whose answers come late on purpose, and the thread that keeps its line alive."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence

import zmq

from surg_policy_bridge.nodes.router_node import Router
from surg_policy_bridge.server.model_server import ModelServer, ServerSettings
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_bridge.server.sessions import new_number
from surg_policy_bridge.server.wire_endpoint import WireEndpoint
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message, WireError

POLL_MS = 50
"""Between two looks at the other side [ms]."""


class DelayedServer(ModelServer):
    """A model server that serves what a HELLO names, and takes answers in when they are due.

    Args:
        spec_of: The specification for the observations that a policy names; None: it names none.
        delay: Of answers, in grid times.
        settings: Constants.
        safety: Judges every step.
    """

    def __init__(
        self,
        spec_of: Callable[[Sequence[str] | None], Spec],
        delay: int,
        settings: ServerSettings,
        safety: SafetyController,
    ) -> None:
        super().__init__(settings, safety, new_number)
        self._spec_of, self._delay = spec_of, delay
        self._held: list[tuple[int, bytes, Message]] = []
        self._step = 0
        self.heard = 0
        """Newest observation that has an answer, due or not."""
        self.lost_touch = False
        """Somebody greets while a policy is in session: its client has given the connection up."""
        self.refusal = ""
        """What the newest refusal says."""

    def receive(self, peer: bytes, message: Message, now: int) -> None:
        """Take in a message; an answer waits for `deliver`."""
        session = self.session
        if message.kind == "HELLO" and session is None:
            wants = message.head["wants"]
            named = None if wants is None else tuple(Spec.from_map(wants).observation)
            self.serve(self._spec_of(named), now)
        elif message.kind == "HELLO" and session is not None and peer != session.peer:
            self.lost_touch = True
        if message.kind != "ACT":
            super().receive(peer, message, now)
            return
        self.heard = max(self.heard, int(message.head["seq"]))
        self._held.append((self._step + self._delay, peer, message))

    def refuse_malformed(self, peer: bytes, error: WireError) -> None:
        """Frames that are no message were an answer all the same."""
        super().refuse_malformed(peer, error)
        if self.session is not None and peer == self.session.peer:
            self.heard = self.session.seq

    def _refuse(self, peer: bytes, code: str, text: str) -> None:
        self.refusal = text
        super()._refuse(peer, code, text)

    def deliver(self, step: int, now: int) -> None:
        """It is this grid time: take in the answers that are due."""
        self._step = step
        due = [each for each in self._held if each[0] <= step]
        self._held = [each for each in self._held if each[0] > step]
        for _, peer, message in due:
            super().receive(peer, message, now)


class Line:
    """The socket of a server, in a thread that answers pings while the simulator computes.

    Attributes:
        lock: Held whenever the server is used; notified when messages have come.
    """

    def __init__(self, address: str, server: ModelServer) -> None:
        self.lock = threading.Condition()
        self._server, self._endpoint = server, WireEndpoint(server)
        self._router = Router(address, None)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def rouse(self) -> None:
        """Send what the server has to say now."""
        os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Send the rest and close."""
        self._over = True
        self.rouse()
        self._thread.join()
        os.close(self._wake)

    def _run(self) -> None:
        poller = zmq.Poller()
        for source in (self._router.socket, self._wake):
            poller.register(source, zmq.POLLIN)
        over = False
        while not over:
            over = self._over  # asked first, so that the last words are sent
            if self._wake in dict(poller.poll(POLL_MS)):
                os.eventfd_read(self._wake)
            with self.lock:
                for peer, parts in self._router.receive():
                    self._endpoint.receive(peer, parts, time.monotonic_ns())
                frames = self._endpoint.take_frames()
                self.lock.notify_all()
            for peer, parts in frames:
                self._router.send(peer, parts)
        self._router.close()
