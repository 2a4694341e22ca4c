"""Messages of the server to a policy, one function per kind (docs/reference/protocol.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from surg_core.contract import SECOND_NS
from surg_policy_bridge.server.sessions import PolicySession
from surg_policy_client.wire import MAX_SENTENCE, Message

PING = 50_000_000
"""[ns] Ping interval that the server asks for."""


def welcome(session: PolicySession, max_obs_age: int, silence: int) -> Message:
    """A session is open; ages and timeouts in [ns]."""
    return Message(
        "WELCOME",
        {
            "version": session.version,
            "session": session.number,
            "spec": session.spec.to_map(),
            "max_obs_age_s": max_obs_age / SECOND_NS,
            "ping_s": PING / SECOND_NS,
            "silence_s": silence / SECOND_NS,
        },
    )


def acknowledgement(
    session: PolicySession, seq: int, tally: Mapping[str, Any], queued: int
) -> Message:
    """What has become of the steps that answer observation ``seq``, and of earlier ones."""
    return Message("ACK", {"session": session.number, "seq": seq, "queue": queued, **tally})


def rejected_step(step: int, rule: str, text: str) -> dict[str, Any]:
    """One entry of an ACK's ``rejected``."""
    return {"step": step, "rule": rule, "text": text[:MAX_SENTENCE]}


def episode(
    session: PolicySession,
    number: int,
    event: str,
    instruction: str,
    success: bool | None,
    reason: str,
) -> Message:
    """An episode begins, is paused, resumes or ends."""
    return Message(
        "EPISODE",
        {
            "session": session.number,
            "episode": number,
            "event": event,
            "instruction": instruction,
            "success": success,
            "reason": reason[:MAX_SENTENCE],
        },
    )
