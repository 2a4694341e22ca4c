"""Protocol state of a client, without sockets, clocks or threads; time is an argument."""

from __future__ import annotations

import enum
from typing import Any

from surg_policy_client.errors import PolicyClientError, Refused, SpecMismatch, VersionMismatch
from surg_policy_client.spec import Spec
from surg_policy_client.wire import TELLS, VERSION, Message

HELLO_S = 0.25
"""[s] Interval of HELLO until a server answers."""
LEAST_PING_S = 0.01
"""[s] Shortest interval of PING, whatever the server asks for."""
LOST_S = 1.0
"""[s] Timeout of the server: it has ended, or serves another session."""


class ConversationState(enum.Enum):
    """ConversationState of a conversation."""

    GREETING = "greeting"
    LIVE = "live"
    FAILED = "failed"


class Conversation:
    """Sends HELLO and PING, and detects the loss of the server.

    Args:
        address: Of the server, for error messages.
        hello: Fields of HELLO except `versions`.

    Attributes:
        session: Number of the session; None before WELCOME.
        welcome: Fields of WELCOME.
        generation: Number of the connection; a new one needs a new socket.
        failure: Final error; None: there is none.
        busy: Why the server is busy with another policy; may be empty.
    """

    def __init__(self, address: str, hello: dict[str, Any]) -> None:
        self.address = address
        self.state = ConversationState.GREETING
        self.session: int | None = None
        self.welcome: dict[str, Any] = {}
        self.generation = 0
        self.failure: PolicyClientError | None = None
        self.busy = ""
        self._hello = {"versions": [1, VERSION], **hello}
        self._ping_s = 0.05
        self._next = self._earliest = float("-inf")
        self._heard = 0.0
        self._pings = 0

    @property
    def tells(self) -> bool:
        """Whether the server takes in what the policy sees."""
        return bool(self.welcome) and bool(self.welcome["version"] >= TELLS)

    def due(self) -> float:
        """Time of the next call of `tick` [s]."""
        if self.state is ConversationState.FAILED:
            return float("inf")
        if self.state is ConversationState.LIVE:
            return min(self._next, self._heard + LOST_S)
        return self._next

    def reached(self) -> None:
        """The connection is up: send HELLO at once."""
        if self.state is ConversationState.GREETING:
            self._next = self._earliest

    def tick(self, now: float) -> list[Message]:
        """Messages that are due at a time [s]."""
        if self.state is ConversationState.LIVE and now >= self._heard + LOST_S:
            self._restart()
        if now < self._next or self.state is ConversationState.FAILED:
            return []
        if self.state is ConversationState.GREETING:
            self._next = now + HELLO_S
            return [Message("HELLO", dict(self._hello))]
        # Counted from now, so that a process that was stopped sends no burst.
        self._next = now + self._ping_s
        self._pings = (self._pings + 1) % 2**31
        return [Message("PING", {"session": self.session, "n": self._pings})]

    def take(self, message: Message, now: float) -> Message | None:
        """Take in a message of the server at a time [s]; returns it if the policy needs it."""
        if self.state is ConversationState.FAILED:
            return None
        if message.kind == "ERR":
            return self._error(message.head["code"], message.head["text"], message)
        if message.kind == "WELCOME":
            return self._welcomed(message, now)
        if self.state is not ConversationState.LIVE or message.head.get("session") != self.session:
            return None  # of an earlier session
        self._heard = now
        if message.kind == "BYE":
            # Wait a moment: a new server needs the address of the old one.
            self._restart(now + HELLO_S)
        return None if message.kind == "PONG" else message

    def _welcomed(self, message: Message, now: float) -> Message | None:
        if self.state is ConversationState.LIVE and message.head["session"] == self.session:
            return None  # answer to a repeated HELLO
        if not 1 <= message.head["version"] <= VERSION:
            self._fail(VersionMismatch(self._version_text(f"version {message.head['version']}")))
            return None
        wants = self._hello["wants"]
        served = Spec.from_map(message.head["spec"])
        wrong = Spec.from_map(wants).mismatches(served) if wants is not None else []
        if wrong:
            self._fail(SpecMismatch(self._mismatch("\n".join(wrong))))
            return None
        self.state, self.session, self.welcome = (
            ConversationState.LIVE,
            message.head["session"],
            message.head,
        )
        self._ping_s = max(message.head["ping_s"], LEAST_PING_S)
        self._heard, self._next, self.busy = now, now, ""
        return message

    def _error(self, code: str, text: str, message: Message) -> Message | None:
        if code == "version":
            self._fail(VersionMismatch(self._version_text(text)))
        elif code == "spec":
            self._fail(SpecMismatch(self._mismatch(text)))
        elif code == "session":
            if self.state is ConversationState.LIVE:
                self._restart()
        elif code == "busy":
            self.busy = text
        elif self.state is ConversationState.LIVE:
            return message  # for the policy: a refused reset or message
        else:
            self._fail(Refused(code, f"the server at {self.address} refused: {text}"))
        return None

    def _restart(self, earliest: float = float("-inf")) -> None:
        self.state, self.session = ConversationState.GREETING, None
        self.generation += 1
        self._next = self._earliest = earliest

    def _fail(self, failure: PolicyClientError) -> None:
        self.state, self.failure = ConversationState.FAILED, failure

    def _version_text(self, theirs: str) -> str:
        return (
            f"the server at {self.address} uses another protocol; this client has versions "
            f"1 to {VERSION}, the server reports: {theirs}. Install the surg-policy-client of the "
            "server's checkout (src/surg_policy_bridge/client)."
        )

    def _mismatch(self, what: str) -> str:
        return (
            f"the policy does not fit the server at {self.address}:\n{what}\n"
            "Start the server with the task and cell that the policy was trained for, or change "
            "`wants`."
        )
