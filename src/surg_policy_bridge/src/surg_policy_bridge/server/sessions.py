"""Who talks: one policy at a time, by a session that nobody can guess, and no faster than it may.

A session ends with a BYE, with 150 ms of silence, or with the server. Its number is random: what a
former client or a recording of the wire sends is of another session and is not obeyed (F29).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from surg_policy_bridge.server.policy_arm import SECOND
from surg_policy_bridge.server.timers import SILENCE, Patience
from surg_policy_client.spec import Spec

RATE, BURST = 500, 200
"""Messages of a peer per second, and at once; what comes above is not even looked into (F18)."""
PEERS = 64
"""Peers that are remembered; the longest unheard is forgotten first."""
SENT = 64
"""Observations that may still be answered."""


@dataclass
class Bucket:
    """Lets `RATE` messages per second through, `BURST` at once.

    Attributes:
        filled: Tokens that are there, in units of 1 / RATE / SECOND.
        at: When they were counted [ns].
    """

    filled: int = BURST * SECOND
    at: int = 0

    def take(self, now: int) -> bool:
        """Whether one more message may come."""
        self.filled = min(self.filled + max(now - self.at, 0) * RATE, BURST * SECOND)
        self.at = max(now, self.at)
        if self.filled < SECOND:
            return False
        self.filled -= SECOND
        return True


class Flow:
    """The buckets of all peers."""

    def __init__(self) -> None:
        self._buckets: OrderedDict[bytes, Bucket] = OrderedDict()

    def admits(self, peer: bytes, now: int) -> bool:
        """Whether a peer's message is looked into."""
        bucket = self._buckets.get(peer)
        if bucket is None:
            bucket = self._buckets[peer] = Bucket(at=now)
            if len(self._buckets) > PEERS:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(peer)
        return bucket.take(now)


@dataclass(frozen=True)
class Sent:
    """An observation that was sent.

    Attributes:
        stamp_ns: Its stamp.
        step: Its grid time.
        seen: When it was taken, on the clock of the execution [ns].
        sent: When it was sent, on the steady clock [ns].
    """

    stamp_ns: int
    step: int
    seen: int
    sent: int


@dataclass
class Session:
    """A policy that is connected.

    Attributes:
        number: Random; on every message of the session.
        peer: Identity of its connection.
        client: Its name.
        policy: Name of its policy.
        spec: What it is served.
        silence: Since when nothing has been heard.
        sent: Observations that it may answer, by sequence number.
        seq: Of the newest observation.
        answered: Of the newest observation that it has answered, or may no longer answer.
        acted: It has answered one.
    """

    number: int
    peer: bytes
    client: str
    policy: str
    spec: Spec
    silence: Patience = field(default_factory=lambda: Patience(SILENCE))
    sent: OrderedDict[int, Sent] = field(default_factory=OrderedDict)
    seq: int = 0
    answered: int = 0
    acted: bool = False

    def heard(self, now: int) -> None:
        """A message of it has come."""
        self.silence.since = now

    def note(self, sent: Sent) -> int:
        """An observation goes out; returns its sequence number."""
        self.seq += 1
        self.sent[self.seq] = sent
        if len(self.sent) > SENT:
            self.sent.popitem(last=False)
        return self.seq


def refusal(head: Mapping[str, Any], versions: range, served: Spec) -> tuple[str, str] | None:
    """Why a HELLO cannot be answered with a session: code and text, naming both sides.

    Args:
        head: Of the HELLO.
        versions: Of the protocol that this server speaks.
        served: What this server has.
    """
    low, high = head["versions"]
    if high < versions.start or low >= versions.stop:
        return "version", (
            f"the client speaks versions {low} to {high} of the protocol, this server "
            f"{versions.start} to {versions.stop - 1}: install the client of this release"
        )
    wrong = Spec.from_map(head["wants"]).mismatches(served) if head["wants"] is not None else []
    return ("spec", "; ".join(wrong)) if wrong else None


def spec_for(head: Mapping[str, Any], served: Spec) -> Spec:
    """What a client is served: the observations that it named, or all."""
    wanted = Spec.from_map(head["wants"]).observation if head["wants"] is not None else {}
    return served.only(list(wanted)) if wanted else served
