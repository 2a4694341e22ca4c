"""Fields of each kind of message, and what each may hold (docs/reference/protocol.md)."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Optional

from surg_policy_client.header import MAX_LIST
from surg_policy_client.spec import Spec, SpecError

_KINDS = "HELLO WELCOME OBS ACT ACK PING PONG RESET EPISODE BYE ERR"
KINDS = {name: number for number, name in enumerate(_KINDS.split(), 1)}
"""Number of each kind in the header."""
EVENTS = ("begin", "end", "paused", "resumed")
"""Events of EPISODE."""

MAX_ROWS = MAX_LIST
"""Rows of a chunk. An empty chunk means that earlier rows stay valid."""
MAX_SENTENCE = 1024
"""[characters] Longest instruction or reason."""

Check = Callable[[Any], Optional[str]]
"""Returns what is allowed; None: the value is valid."""


def _integer(low: int, high: int) -> Check:
    allowed = f"an integer from {low} to {high}"
    return lambda v: None if type(v) is int and low <= v <= high else allowed


def _real(low: float, high: float) -> Check:
    allowed = f"a number from {low:g} to {high:g}"
    return lambda v: None if type(v) in (int, float) and low <= v <= high else allowed


def _text(most: int) -> Check:
    allowed = f"a text of at most {most} characters"
    return lambda v: None if type(v) is str and len(v) <= most else allowed


def _one_of(*words: str) -> Check:
    return lambda v: None if type(v) is str and v in words else f"one of {', '.join(words)}"


def _verdict(value: Any) -> str | None:
    return None if value is None or type(value) is bool else "true, false or nil"


def _versions(value: Any) -> str | None:
    good = (
        type(value) is list
        and len(value) == 2
        and all(type(v) is int and 1 <= v <= 65535 for v in value)
        and value[0] <= value[1]
    )
    return None if good else "a list [lowest, highest] of versions from 1 to 65535"


def _rejections(value: Any) -> str | None:
    allowed = f"a list of at most {MAX_ROWS} maps {{step, rule, text}}"
    if type(value) is not list or len(value) > MAX_ROWS:
        return allowed
    return next((allowed for each in value if wrong_field(each, _REJECTION)), None)


def _spec(value: Any) -> str | None:
    try:
        Spec.from_map(value)
    except SpecError as error:
        return str(error)
    return None


def _maybe_spec(value: Any) -> str | None:
    return None if value is None else _spec(value)


_SESSION = _integer(1, 2**64 - 1)
_COUNT = _integer(0, 2**31 - 1)
_STEP = _integer(-(2**62), 2**62)
_STAMP = _integer(0, 2**63 - 1)
_REJECTION: dict[str, Check] = {"step": _STEP, "rule": _text(64), "text": _text(MAX_SENTENCE)}
FIELDS: dict[str, dict[str, Check]] = {
    "HELLO": {
        "versions": _versions,
        "client": _text(128),
        "software": _text(256),
        "policy": _text(256),
        "wants": _maybe_spec,
    },
    "WELCOME": {
        "version": _integer(1, 65535),
        "session": _SESSION,
        "spec": _spec,
        "max_obs_age_s": _real(0.0, 60.0),
        "ping_s": _real(0.0, 60.0),
        "silence_s": _real(0.0, 60.0),
    },
    "OBS": {
        "session": _SESSION,
        "seq": _COUNT,
        "stamp_ns": _STAMP,
        "episode": _COUNT,
        "step": _STEP,
        "instruction": _text(MAX_SENTENCE),
    },
    "ACT": {"session": _SESSION, "seq": _COUNT, "stamp_ns": _STAMP, "step0": _STEP},
    "ACK": {
        "session": _SESSION,
        "seq": _COUNT,
        "accepted": _COUNT,
        "clipped": _COUNT,
        "late": _COUNT,
        "stale": _COUNT,
        "rejected": _rejections,
        "queue": _COUNT,
    },
    "PING": {"session": _SESSION, "n": _COUNT},
    "PONG": {"session": _SESSION, "n": _COUNT},
    "RESET": {"session": _SESSION},
    "EPISODE": {
        "session": _SESSION,
        "episode": _COUNT,
        "event": _one_of(*EVENTS),
        "instruction": _text(MAX_SENTENCE),
        "success": _verdict,
        "reason": _text(MAX_SENTENCE),
    },
    "BYE": {"session": _SESSION, "reason": _text(MAX_SENTENCE)},
    "ERR": {"code": _text(64), "text": _text(65536)},
}


def wrong_field(head: Any, fields: Mapping[str, Check]) -> tuple[str, str] | None:
    """Code and text of what is wrong with a map; None: nothing."""
    if type(head) is not dict or head.keys() != fields.keys():
        there = sorted(map(str, head)) if type(head) is dict else type(head).__name__
        return "keys", f"fields {str(there)[:200]}; allowed: exactly {', '.join(fields)}"
    for name, check in fields.items():
        allowed = check(head[name])
        if allowed is not None:
            return "spec" if name in ("wants", "spec") else "field", f"{name}: {allowed}"
    return None
