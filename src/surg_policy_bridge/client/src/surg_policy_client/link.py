"""Connection to a model server: a thread owns the socket, pings and receives."""

from __future__ import annotations

import collections
import math
import os
import platform
import socket
import threading
import time
from pathlib import Path
from typing import Any

import zmq
from zmq.utils import monitor

from surg_policy_client.connection_hint import HANDSHAKE_FAILED, ConnectionHint
from surg_policy_client.conversation import Conversation, ConversationState
from surg_policy_client.errors import BadAddress, NoServer
from surg_policy_client.keys import ClientKeys, Folder, client_keys
from surg_policy_client.spec import Spec
from surg_policy_client.version import __version__
from surg_policy_client.wire import MAX_PART, Message, decode, encode, receive

_LINGER_MS = 200
_RENEW_S = 1.0
"""[s] Time after a failed handshake until a new socket is opened."""


class Link:
    """A conversation with a server over ZeroMQ.

    Args:
        address: Such as ``tcp://127.0.0.1:5555`` or ``ipc:///tmp/policy``.
        wants: What the policy needs; None: everything served.
        policy: Name of the policy, for the server's log.
        keys: Keys, or a folder made by `./surg policy keys`.
    """

    def __init__(
        self,
        address: str,
        *,
        wants: Spec | None = None,
        policy: str = "",
        keys: ClientKeys | Folder | None = None,
    ) -> None:
        self.address = address
        if keys is not None and not isinstance(keys, ClientKeys):
            keys = client_keys(Path(keys))
        self._keys = keys
        self._conversation = Conversation(
            address,
            {
                "client": f"{socket.gethostname()}:{os.getpid()}"[:128],
                "software": f"surg-policy-client {__version__}, Python {platform.python_version()}",
                "policy": policy[:256],
                "wants": None if wants is None else wants.to_map(),
            },
        )
        self._context = zmq.Context()
        self._inbox: collections.deque[Message] = collections.deque(maxlen=1024)
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._hint = ConnectionHint()
        self._renew = math.inf
        self._stop = False
        self._closed = False
        self._broken: Exception | None = None
        self.skipped = 0
        """Observations replaced by a newer one before the policy was ready."""
        self.dropped = 0
        """Messages that could not be sent, and invalid frames."""
        try:
            self._first: Any = self._socket()  # a bad address fails here
        except BadAddress:
            self._context.term()
            raise
        self._outbox = self._context.socket(zmq.PAIR)
        self._outbox.bind("inproc://out")
        self._thread = threading.Thread(target=self._run, name="surg-policy-link", daemon=True)
        self._thread.start()

    # --- the policy's side ------------------------------------------------------------------------

    @property
    def session(self) -> int | None:
        """Number of the session; None: there is none."""
        return self._conversation.session

    @property
    def tells(self) -> bool:
        """Whether the server takes in what the policy sees; an old one does not."""
        return self._conversation.tells

    def wait_for_welcome(self, timeout_s: float) -> bool:
        """Wait for a session; returns whether there is one.

        Raises:
            PolicyClientError: Server and policy do not match.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._conversation.state is not ConversationState.GREETING or self._stop,
                timeout_s,
            )
            self._raise_failure()
            return self._conversation.state is ConversationState.LIVE

    def no_server(self, timeout_s: float) -> NoServer:
        """The error for a timeout."""
        return NoServer(f"no answer from {self.address} within {timeout_s:g} s: {self.hint()}")

    def hint(self) -> str:
        """Why there is probably no session, and what to do."""
        if self._conversation.busy:
            return f"the server is busy: {self._conversation.busy}"
        return self._hint.text

    def next(self, timeout_s: float) -> Message | None:
        """Next message of the server: WELCOME, OBS, ACK, EPISODE, BYE or ERR; None: timeout.

        Only the newest observation is kept.

        Raises:
            PolicyClientError: Server and policy do not match.
        """
        with self._news:
            self._news.wait_for(
                lambda: (
                    self._inbox
                    or self._conversation.state is ConversationState.FAILED
                    or self._stop
                ),
                timeout_s,
            )
            if self._inbox:
                return self._inbox.popleft()
            self._raise_failure()
            return None

    def send(self, message: Message) -> None:
        """Send a message; it is dropped (and counted) while there is no connection."""
        parts = encode(message)
        self._post(parts)

    def close(self, reason: str = "the policy ended") -> None:
        """Send BYE and end the thread."""
        if self._closed:
            return
        session = self.session
        if session is not None:
            self.send(Message("BYE", {"session": session, "reason": reason[:1024]}))
        self._post([b""])
        self._closed = True
        self._thread.join()
        self._outbox.close(0)
        self._context.term()

    def _post(self, parts: list[Any]) -> None:
        """Pass frames to the thread; dropped if it has ended."""
        with self._sending:
            try:
                if not self._closed:
                    self._outbox.send_multipart(parts, zmq.NOBLOCK, copy=False)
            except zmq.Again:
                self.dropped += 1

    def _raise_failure(self) -> None:
        failure = self._conversation.failure or self._broken
        if failure is not None:
            raise failure

    # --- the thread -------------------------------------------------------------------------------

    def _run(self) -> None:
        out = self._context.socket(zmq.PAIR)
        out.connect("inproc://out")
        try:
            while self._one_connection(out):
                pass
        except Exception as error:  # reported to whoever waits
            self._broken = error
        finally:
            out.close(0)
            with self._news:
                self._stop = True
                self._news.notify_all()

    def _one_connection(self, out: Any) -> bool:
        """Serve one socket; returns whether another one is needed."""
        conversation = self._conversation
        generation = conversation.generation
        self._renew = math.inf
        wire, self._first = self._first or self._socket(), None
        watch = wire.get_monitor_socket()  # the same as in _socket
        poller = zmq.Poller()
        for source in (wire, out, watch):
            poller.register(source, zmq.POLLIN)
        try:
            while conversation.generation == generation and time.monotonic() < self._renew:
                for message in conversation.tick(time.monotonic()):
                    self._put(wire, encode(message))
                wait = min(conversation.due(), self._renew) - time.monotonic()
                wait_ms = None if math.isinf(wait) else max(0, math.ceil(1e3 * wait))
                ready = dict(poller.poll(wait_ms))
                if wire in ready:
                    self._listen(wire)
                if watch in ready:
                    self._note(monitor.recv_monitor_message(watch)["event"])
                if out in ready:
                    parts = out.recv_multipart(copy=False)
                    if len(parts) == 1 and len(parts[0].buffer) == 0:
                        return False
                    self._put(wire, parts)
            return True
        finally:
            wire.disable_monitor()
            watch.close(0)
            wire.close(_LINGER_MS)

    def _socket(self) -> Any:
        wire = self._context.socket(zmq.DEALER)
        wire.setsockopt(zmq.MAXMSGSIZE, MAX_PART)
        wire.setsockopt(zmq.RCVHWM, 64)
        wire.setsockopt(zmq.SNDHWM, 8)
        wire.setsockopt(zmq.IMMEDIATE, 1)  # queue nothing without a connection
        wire.setsockopt(zmq.RECONNECT_IVL, 100)
        wire.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        if self._keys is not None:
            wire.curve_publickey = self._keys.public
            wire.curve_secretkey = self._keys.secret
            wire.curve_serverkey = self._keys.server
        # Before the first attempt: ZeroMQ may not retry after a failed handshake.
        watch = wire.get_monitor_socket()
        try:
            wire.connect(self.address)
        except zmq.ZMQError as error:
            wire.disable_monitor()
            watch.close(0)
            wire.close(0)
            raise BadAddress(
                f"{self.address!r} is not an address ({error}); allowed: tcp://HOST:PORT and "
                "ipc://PATH, such as tcp://127.0.0.1:5555"
            ) from None
        return wire

    def _put(self, wire: Any, parts: list[Any]) -> None:
        try:
            wire.send_multipart(parts, zmq.NOBLOCK, copy=False)
        except zmq.Again:
            self.dropped += 1

    def _listen(self, wire: Any) -> None:
        """Receive all messages."""
        while True:
            try:
                parts = receive(wire, zmq.NOBLOCK)
            except zmq.Again:
                return
            try:
                message = decode(parts)
            except Exception:  # WireError, or an oversight in the codec
                self.dropped += 1
                continue
            with self._news:
                kept = self._conversation.take(message, time.monotonic())
                if kept is not None:
                    self._keep(kept)
                self._news.notify_all()

    def _keep(self, message: Message) -> None:
        if message.kind == "OBS":
            older = next((n for n, m in enumerate(self._inbox) if m.kind == "OBS"), None)
            if older is not None:
                del self._inbox[older]
                self.skipped += 1
        self._inbox.append(message)

    def _note(self, event: int) -> None:
        """Take in an event of the socket."""
        self._hint.note(event)
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._conversation.reached()
        elif event in HANDSHAKE_FAILED:
            self._renew = time.monotonic() + _RENEW_S
