"""One connection to a model server: a thread that owns the socket, pings and listens."""

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

from surg_policy_client import __version__
from surg_policy_client.conversation import Conversation, State
from surg_policy_client.errors import NoServer
from surg_policy_client.keys import ClientKeys, Folder, client_keys
from surg_policy_client.spec import Spec
from surg_policy_client.wire import MAX_PART, Message, decode, encode, receive

_LINGER_MS = 200
_RENEW_S = 1.0
"""After a handshake that failed: the server may be another one by then."""
_HINTS = {
    "": "nobody listens there. Start a server (./surg run TASK --policy ADDRESS), or look at the "
    "address, and at the firewall between the machines.",
    "connected": "somebody listens there, but no model server answered. Is the address the one the "
    "server prints when it starts?",
    "protocol": "the server there and this client do not agree about keys: give `keys` the "
    "policy's folder of `./surg keys` if the server was started with keys, and leave it out "
    "otherwise.",
    "denied": "the server there does not know this client's key. Copy the policy's *.key into the "
    "server's folder `server/clients` (./surg keys), and start the server again.",
}


class Link:
    """A conversation with a server over ZeroMQ.

    Args:
        address: Such as ``tcp://127.0.0.1:5555`` or ``ipc:///tmp/policy``.
        wants: What the policy needs; None: whatever there is.
        policy: Its name, for the server's log.
        keys: Keys, or the folder that `./surg keys` made.
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
        self._talk = Conversation(
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
        self._hint = ""
        self._renew = math.inf
        self._stop = False
        self._closed = False
        self._broken: Exception | None = None
        self.skipped = 0
        """Observations that a newer one replaced before the policy was ready."""
        self.dropped = 0
        """Messages that could not be sent, and frames that were no messages."""
        try:
            self._first: Any = self._socket()  # here, so that a bad address fails here
        except ValueError:
            self._context.term()
            raise
        self._outbox = self._context.socket(zmq.PAIR)
        self._outbox.bind("inproc://out")
        self._thread = threading.Thread(target=self._run, name="surg-policy-link", daemon=True)
        self._thread.start()

    # --- the policy's side ------------------------------------------------------------------------

    @property
    def session(self) -> int | None:
        """Number of the session; None while there is none."""
        return self._talk.session

    def wait_for_welcome(self, timeout_s: float) -> bool:
        """Wait until a session stands.

        Args:
            timeout_s: Longest wait [s].

        Returns:
            Whether it does.

        Raises:
            PolicyClientError: When server and policy do not fit.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._talk.state is not State.GREETING or self._stop, timeout_s
            )
            self._raise_failure()
            return self._talk.state is State.LIVE

    def no_server(self, timeout_s: float) -> NoServer:
        """The error of a wait that was too long."""
        return NoServer(f"no answer from {self.address} within {timeout_s:g} s: {self.hint()}")

    def hint(self) -> str:
        """Why there is no session, as far as can be seen from here, and what to do."""
        if self._talk.busy:
            return f"another policy holds the server: {self._talk.busy}"
        return _HINTS[self._hint]

    def next(self, timeout_s: float) -> Message | None:
        """The server's next word: WELCOME, OBS, ACK, EPISODE, BYE or ERR; None after the time.

        Of observations only the newest waits here.

        Raises:
            PolicyClientError: When server and policy do not fit.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._inbox or self._talk.state is State.FAILED or self._stop, timeout_s
            )
            if self._inbox:
                return self._inbox.popleft()
            self._raise_failure()
            return None

    def send(self, message: Message) -> None:
        """Hand a message to the connection; it is dropped (and counted) while there is none."""
        parts = encode(message)
        self._hand_over(parts)

    def close(self, reason: str = "the policy ended") -> None:
        """Say goodbye and end the thread."""
        if self._closed:
            return
        session = self.session
        if session is not None:
            self.send(Message("BYE", {"session": session, "reason": reason[:1024]}))
        self._hand_over([b""])
        self._closed = True
        self._thread.join()
        self._outbox.close(0)
        self._context.term()

    def _hand_over(self, parts: list[Any]) -> None:
        """To the thread; dropped where it has ended, for nobody would ever take it."""
        with self._sending:
            try:
                if not self._closed:
                    self._outbox.send_multipart(parts, zmq.NOBLOCK, copy=False)
            except zmq.Again:
                self.dropped += 1

    def _raise_failure(self) -> None:
        failure = self._talk.failure or self._broken
        if failure is not None:
            raise failure

    # --- the thread -------------------------------------------------------------------------------

    def _run(self) -> None:
        out = self._context.socket(zmq.PAIR)
        out.connect("inproc://out")
        try:
            while self._one_connection(out):
                pass
        except Exception as error:  # whoever waits for news has to hear of it
            self._broken = error
        finally:
            out.close(0)
            with self._news:
                self._stop = True
                self._news.notify_all()

    def _one_connection(self, out: Any) -> bool:
        """One socket's life; returns whether another shall follow."""
        talk, generation = self._talk, self._talk.generation
        self._renew = math.inf
        wire, self._first = self._first or self._socket(), None
        watch = wire.get_monitor_socket()  # the same as in _socket
        poller = zmq.Poller()
        for each in (wire, out, watch):
            poller.register(each, zmq.POLLIN)
        try:
            while talk.generation == generation and time.monotonic() < self._renew:
                for message in talk.tick(time.monotonic()):
                    self._put(wire, encode(message))
                wait = min(talk.due(), self._renew) - time.monotonic()
                wait_ms = None if math.isinf(wait) else max(0, math.ceil(1e3 * wait))
                ready = dict(poller.poll(wait_ms))
                if wire in ready:
                    self._listen(wire)
                if watch in ready:
                    self._note(monitor.recv_monitor_message(watch))
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
        wire.setsockopt(zmq.IMMEDIATE, 1)  # nothing waits for a server that is not there
        wire.setsockopt(zmq.RECONNECT_IVL, 100)
        wire.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        if self._keys is not None:
            wire.curve_publickey = self._keys.public
            wire.curve_secretkey = self._keys.secret
            wire.curve_serverkey = self._keys.server
        # Before the first attempt: after a handshake that failed ZeroMQ may not try again.
        watch = wire.get_monitor_socket()
        try:
            wire.connect(self.address)
        except zmq.ZMQError as error:
            wire.disable_monitor()
            watch.close(0)
            wire.close(0)
            raise ValueError(
                f"{self.address!r} is no address ({error}); "
                "tcp://HOST:PORT and ipc://PATH are, such as tcp://127.0.0.1:5555"
            ) from None
        return wire

    def _put(self, wire: Any, parts: list[Any]) -> None:
        try:
            wire.send_multipart(parts, zmq.NOBLOCK, copy=False)
        except zmq.Again:
            self.dropped += 1

    def _listen(self, wire: Any) -> None:
        """Everything that has come."""
        while True:
            try:
                parts = receive(wire, zmq.NOBLOCK)
            except zmq.Again:
                return
            try:
                message = decode(parts)
            except Exception:  # WireError, or what the codec may have overlooked
                self.dropped += 1
                continue
            with self._news:
                told = self._talk.take(message, time.monotonic())
                if told is not None:
                    self._keep(told)
                self._news.notify_all()

    def _keep(self, message: Message) -> None:
        if message.kind == "OBS":
            older = next((n for n, each in enumerate(self._inbox) if each.kind == "OBS"), None)
            if older is not None:
                del self._inbox[older]
                self.skipped += 1
        self._inbox.append(message)

    def _note(self, event: dict[str, Any]) -> None:
        """What the connection's events say about a server that does not answer."""
        kind = event["event"]
        if kind == zmq.EVENT_CONNECTED:
            self._hint = self._hint or "connected"
        elif kind == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._hint = "connected"
            self._talk.reached()
        elif kind == zmq.EVENT_CLOSED and self._hint == "connected":
            self._hint = ""  # an attempt that reached nobody; what a handshake told stays true
        elif kind == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            self._hint = "denied"
            self._renew = time.monotonic() + _RENEW_S
        elif kind in (
            zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL,
            zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL,
        ):
            self._hint = "protocol"
            self._renew = time.monotonic() + _RENEW_S
