"""What a client says and when, without sockets, clocks and threads: time is an argument."""

from __future__ import annotations

import enum
from typing import Any

from surg_policy_client.errors import PolicyClientError, Refused, SpecMismatch, VersionMismatch
from surg_policy_client.spec import Spec
from surg_policy_client.wire import VERSION, Message

HELLO_S = 0.25
"""Between two HELLOs, until a server answers."""
LEAST_PING_S = 0.01
"""Between two PINGs, whatever a server asks for."""
LOST_S = 1.0
"""Without a word of the server: it is gone, or has another session now."""


class State(enum.Enum):
    """Of a conversation."""

    GREETING = "greeting"
    LIVE = "live"
    FAILED = "failed"


class Conversation:
    """Greets, pings, and knows when the other side is gone.

    Args:
        address: Of the server, for messages.
        hello: Fields of HELLO but `versions`.

    Attributes:
        session: Number of the session; None before WELCOME.
        welcome: Fields of WELCOME.
        generation: Counts the connections: a new number asks for a new socket.
        failure: Why it cannot go on; None while it can.
        busy: Another policy holds the server.
    """

    def __init__(self, address: str, hello: dict[str, Any]) -> None:
        self.address = address
        self.state = State.GREETING
        self.session: int | None = None
        self.welcome: dict[str, Any] = {}
        self.generation = 0
        self.failure: PolicyClientError | None = None
        self.busy = ""
        self._hello = {"versions": [VERSION, VERSION], **hello}
        self._ping_s = 0.05
        self._next = self._earliest = float("-inf")
        self._heard = 0.0
        self._pings = 0

    def due(self) -> float:
        """When `tick` has something to do [s]."""
        if self.state is State.FAILED:
            return float("inf")
        if self.state is State.LIVE:
            return min(self._next, self._heard + LOST_S)
        return self._next

    def reached(self) -> None:
        """Somebody can hear now: a greeting need not wait for its turn."""
        if self.state is State.GREETING:
            self._next = self._earliest

    def tick(self, now: float) -> list[Message]:
        """Messages that are due.

        Args:
            now: [s]
        """
        if self.state is State.LIVE and now >= self._heard + LOST_S:
            self._start_again()
        if now < self._next or self.state is State.FAILED:
            return []
        if self.state is State.GREETING:
            self._next = now + HELLO_S
            return [Message("HELLO", dict(self._hello))]
        # From now on, not from when it was due: a process that was stopped sends no salvo.
        self._next = now + self._ping_s
        self._pings = (self._pings + 1) % 2**31
        return [Message("PING", {"session": self.session, "n": self._pings})]

    def take(self, message: Message, now: float) -> Message | None:
        """A message of the server; returns what the policy has to know of.

        Args:
            message: Decoded.
            now: [s]
        """
        if self.state is State.FAILED:
            return None
        if message.kind == "ERR":
            return self._error(message.head["code"], message.head["text"], message)
        if message.kind == "WELCOME":
            return self._welcomed(message, now)
        if self.state is not State.LIVE or message.head.get("session") != self.session:
            return None  # a message to an earlier session, or no message of a server
        self._heard = now
        if message.kind == "BYE":
            # A server that ends is not greeted at once: its successor needs its place.
            self._start_again(now + HELLO_S)
        return None if message.kind == "PONG" else message

    def _welcomed(self, message: Message, now: float) -> Message | None:
        if self.state is State.LIVE and message.head["session"] == self.session:
            return None  # a HELLO that was repeated; a newer session would replace the first
        if message.head["version"] != VERSION:
            self._fail(VersionMismatch(self._versions(f"version {message.head['version']}")))
            return None
        wants = self._hello["wants"]
        served = Spec.from_map(message.head["spec"])
        wrong = Spec.from_map(wants).mismatches(served) if wants is not None else []
        if wrong:
            self._fail(SpecMismatch(self._differs("\n".join(wrong))))
            return None
        self.state, self.session, self.welcome = State.LIVE, message.head["session"], message.head
        self._ping_s = max(message.head["ping_s"], LEAST_PING_S)
        self._heard, self._next, self.busy = now, now, ""
        return message

    def _error(self, code: str, text: str, message: Message) -> Message | None:
        if code == "version":
            self._fail(VersionMismatch(self._versions(text)))
        elif code == "spec":
            self._fail(SpecMismatch(self._differs(text)))
        elif code == "session":
            if self.state is State.LIVE:
                self._start_again()
        elif code == "busy":
            self.busy = text
        elif self.state is State.LIVE:
            return message  # the policy's to judge: a refused reset, a message that was wrong
        else:
            self._fail(Refused(code, f"the server at {self.address} refused: {text}"))
        return None

    def _start_again(self, earliest: float = float("-inf")) -> None:
        self.state, self.session = State.GREETING, None
        self.generation += 1
        self._next = self._earliest = earliest

    def _fail(self, failure: PolicyClientError) -> None:
        self.state, self.failure = State.FAILED, failure

    def _versions(self, theirs: str) -> str:
        return (
            f"the server at {self.address} speaks another protocol: this client speaks version "
            f"{VERSION}, the server says: {theirs}. Install the surg-policy-client that belongs to "
            "the server's checkout (src/surg_policy_bridge/client)."
        )

    def _differs(self, what: str) -> str:
        return (
            f"the policy does not fit the server at {self.address}:\n{what}\n"
            "Start the server with the task and cell the policy was trained for, or give `wants` "
            "what the server has."
        )
