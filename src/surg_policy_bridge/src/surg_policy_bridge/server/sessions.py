"""Sessions of policies and the rate limit of their messages.

One policy at a time is in session. A session ends with BYE, with 150 ms of silence, or with the
server. Its number is random, so messages of a former client, or a replay, are refused (F29).
"""

from __future__ import annotations

import secrets
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from surg_core import WristGeometry, action_space
from surg_core.contract import SECOND_NS
from surg_policy_bridge.server.timers import SILENCE, Timeout
from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.spec import Spec

RATE, BURST = 500, 200
"""Messages of a peer per second, and at once; more are dropped undecoded (F18)."""
PEERS = 64
"""Peers with a rate limit of their own; the one idle for longest is forgotten first."""
SENT = 64
"""Observations that may still be answered."""


@dataclass
class TokenBucket:
    """Admits `RATE` messages per second, `BURST` at once; counts tokens in 1 / RATE / SECOND_NS."""

    tokens: int = BURST * SECOND_NS
    at: int = 0

    def take(self, now: int) -> bool:
        """Whether one more message is admitted."""
        self.tokens = min(self.tokens + max(now - self.at, 0) * RATE, BURST * SECOND_NS)
        self.at = max(now, self.at)
        if self.tokens < SECOND_NS:
            return False
        self.tokens -= SECOND_NS
        return True


class RateLimiter:
    """Token buckets of all peers."""

    def __init__(self) -> None:
        self._buckets: OrderedDict[bytes, TokenBucket] = OrderedDict()

    def admits(self, peer: bytes, now: int) -> bool:
        """Whether a message of this peer is decoded."""
        bucket = self._buckets.get(peer)
        if bucket is None:
            bucket = self._buckets[peer] = TokenBucket(at=now)
            if len(self._buckets) > PEERS:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(peer)
        return bucket.take(now)


@dataclass(frozen=True)
class SentObservation:
    """An observation that was sent."""

    stamp_ns: int
    step: int  # its grid time
    seen: int  # when it was taken, on the clock of the execution [ns]
    sent: int  # when it was sent, on the steady clock [ns]


def new_number() -> int:
    """A random number for a session: 63 bits, for a recording's integers have no more."""
    return secrets.randbits(63) or 1


@dataclass
class PolicySession:
    """A connected policy."""

    number: int  # random; part of every message of the session
    peer: bytes  # identity of its connection
    client: str
    policy: str
    spec: Spec  # the specification that it is served
    silence: Timeout = field(default_factory=lambda: Timeout(SILENCE))
    version: int = 1  # of the protocol, that both speak
    # observations that it may answer, by sequence number
    sent: OrderedDict[int, SentObservation] = field(default_factory=OrderedDict)
    seq: int = 0  # number of the newest observation
    answered: int = 0  # newest observation that it has answered, or may no longer answer
    acted: bool = False  # it has answered an observation

    def heard(self, now: int) -> None:
        """A message has arrived."""
        self.silence.since = now

    def note(self, observation: SentObservation) -> int:
        """An observation is sent; returns its sequence number."""
        self.seq += 1
        self.sent[self.seq] = observation
        if len(self.sent) > SENT:
            self.sent.popitem(last=False)
        return self.seq


def in_space_of(head: Mapping[str, Any], served: Spec, arms: Sequence[str]) -> Spec:
    """The served specification, in the action space whose columns a HELLO wants."""
    action = Spec.from_map(head["wants"]).action if head["wants"] is not None else None
    # What an arm holds is what the served columns say; lengths do not matter for names.
    known = served.action.names if served.action is not None else ()
    wrists = tuple(WristGeometry(0.0, 0.0) if f"{arm}/qx" in known else None for arm in arms)
    space = None if action is None else action_space.of_columns(action.names, arms, wrists)
    if space is None or served.action is None or served.action.names == space.columns(arms):
        return served
    names, units = space.columns(arms), space.units(arms)
    return replace(served, action=ActionSpec(names, units, served.action.frame))


def refusal(head: Mapping[str, Any], versions: range, served: Spec) -> tuple[str, str] | None:
    """Why a HELLO is refused: code and text, naming both sides; None: it is not."""
    low, high = head["versions"]
    if high < versions.start or low >= versions.stop:
        return "version", (
            f"the client supports protocol versions {low} to {high}, this server "
            f"{versions.start} to {versions.stop - 1}; install the client of this release"
        )
    wrong = Spec.from_map(head["wants"]).mismatches(served) if head["wants"] is not None else []
    return ("spec", "; ".join(wrong)) if wrong else None


def spec_for(head: Mapping[str, Any], served: Spec) -> Spec:
    """Specification for a client: with the observations that it named, or all."""
    wanted = Spec.from_map(head["wants"]).observation if head["wants"] is not None else {}
    return served.only(list(wanted)) if wanted else served
