"""Messages of the policies' wire, drawn at random, and what a stranger may make of their bytes."""

from __future__ import annotations

import random
from typing import Any

import msgpack
import numpy as np

from helpers.policy.policy_server import spec
from surg_policy_client.attention import Attention, Keypoint
from surg_policy_client.wire import MAGIC, Message
from surg_policy_client.wire_fields import EVENTS, KINDS

TEXTS = ("", "retract the bowel", "Zug: 0,5 N – größer", "\u0000", "手术", "x" * 64)


def draw(rng: random.Random, kind: str | None = None) -> Message:
    """A message that is good, of a kind or of any."""
    kind = kind or rng.choice(list(KINDS))
    session = rng.choice((1, 2**64 - 1, rng.randrange(1, 2**64)))
    count, text = rng.randrange(2**31), rng.choice(TEXTS)
    heads: dict[str, dict[str, Any]] = {
        "HELLO": {
            "versions": sorted(rng.randrange(1, 65536) for _ in range(2)),
            "client": text,
            "software": text,
            "policy": text,
            "wants": rng.choice((None, spec().to_map())),
        },
        "WELCOME": {
            "version": 1,
            "session": session,
            "spec": spec().to_map(),
            "max_obs_age_s": rng.uniform(0, 60),
            "ping_s": rng.choice((0, 0.05)),
            "silence_s": 0.15,
        },
        "OBS": {
            "session": session,
            "seq": count,
            "stamp_ns": rng.randrange(2**63),
            "episode": count,
            "step": rng.randrange(-(2**62), 2**62),
            "instruction": text,
        },
        "ACT": {"session": session, "seq": count, "stamp_ns": 0, "step0": -1},
        "ACK": {
            "session": session,
            **dict.fromkeys(("seq", "accepted", "clipped", "late", "stale", "queue"), count),
            "rejected": [{"step": 3, "rule": "step", "text": text}] * rng.randrange(3),
        },
        "PING": {"session": session, "n": count},
        "PONG": {"session": session, "n": count},
        "RESET": {"session": session},
        "EPISODE": {
            "session": session,
            "episode": count,
            "event": rng.choice(EVENTS),
            "instruction": text,
            "success": rng.choice((None, True, False)),
            "reason": text,
        },
        "BYE": {"session": session, "reason": text},
        "ERR": {"code": "spec", "text": text},
    }
    seen = sight(rng) if kind == "ACT" and rng.random() < 0.5 else None
    return Message(kind, heads[kind], arrays(rng, kind), seen)


def sight(rng: random.Random) -> Attention:
    """What a policy may say that it sees."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    sides = (rng.randint(1, 32), rng.randint(1, 32))
    return Attention(
        keypoints=tuple(
            Keypoint(f"tip {i}", rng.uniform(-2, 2), rng.uniform(-2, 2), rng.random())
            for i in range(rng.randrange(17))
        ),
        phase=rng.choice(("", "pulling", "手术")),
        confidence=rng.choice((None, 0.0, 1.0, rng.random())),
        picture=rng.choice(("", "observation.images.endoscope.left")),
        heat_map=rng.choice((None, numbers.integers(0, 256, sides, dtype=np.uint8))),
        area=rng.choice(((0.0, 0.0, 1.0, 1.0), (0.125, 0.0, 0.875, 1.0))),
    )


def arrays(rng: random.Random, kind: str) -> dict[str, np.ndarray]:
    """What a message of this kind may carry."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    if kind == "ACT":
        dtype = rng.choice(("f4", "f8"))
        shape = rng.choice(((0, 5), (1, 5), (50, 8), (1024, 1)))
        return {"chunk": numbers.normal(size=shape).astype(dtype)}
    found: dict[str, np.ndarray] = {}
    for i in range(rng.randrange(8) if kind == "OBS" else 0):
        shape = [rng.randrange(0, 7) for _ in range(rng.randrange(5))]
        raw = numbers.integers(0, 256, (*shape, 8), dtype=np.uint8)
        dtype = rng.choice(("u1", "i8", "f4", "f8", "b1"))
        if dtype in ("u1", "b1"):
            value = raw[..., 0] & (1 if dtype == "b1" else 255)
            found[f"k{i}"] = value.astype(np.dtype(dtype))
        else:
            found[f"k{i}"] = raw.view(np.dtype("<" + dtype))[..., 0]
    return found


def pack(kind: int, head: Any, magic: bytes = MAGIC) -> bytes:
    """A header of whatever is given."""
    return magic + bytes([kind]) + msgpack.packb(head)


def spoil(rng: random.Random, parts: list[bytes]) -> list[bytes]:
    """A good message's frames with something wrong, or with luck still good."""
    parts = [bytes(part) for part in parts]
    way = rng.randrange(8)
    if way == 0:  # bits
        at = rng.randrange(len(parts))
        if parts[at]:
            data = bytearray(parts[at])
            for _ in range(rng.choice((1, 1, 3, 30))):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            parts[at] = bytes(data)
    elif way == 1:  # cut or longer
        at = rng.randrange(len(parts))
        n = len(parts[at])
        parts[at] = parts[at][: rng.randrange(n + 1)] if rng.random() < 0.6 else parts[at] + b"\0"
    elif way == 2:  # frames missing, twice, in another order
        rng.shuffle(parts)
        parts = parts[: rng.randrange(len(parts) + 1)] or parts + parts
    elif way == 3:  # another kind
        parts[0] = parts[0][:4] + bytes([rng.randrange(256)]) + parts[0][5:]
    elif way == 4:  # a field of another value or type, a field too many, one missing
        head = msgpack.unpackb(parts[0][5:], strict_map_key=False)
        key = rng.choice(list(head))
        head[key] = value(rng)
        if rng.random() < 0.2:
            del head[key]
        if rng.random() < 0.2:
            head[rng.choice(("arrays", "x", "", "session"))] = value(rng)
        parts[0] = pack(parts[0][4], head)
    elif way == 5:  # a description that lies
        head = msgpack.unpackb(parts[0][5:], strict_map_key=False)
        if head.get("arrays"):
            each = rng.choice(head["arrays"])
            each[rng.choice(list(each))] = value(rng)
            parts[0] = pack(parts[0][4], head)
    elif way == 6:  # nothing of ours
        parts = [rng.randbytes(rng.randrange(200)) for _ in range(rng.randrange(12))]
        if parts and rng.random() < 0.7:
            parts[0] = MAGIC + bytes([rng.randrange(13)]) + parts[0]
    else:  # numbers that are none
        data = np.array([rng.choice((np.nan, np.inf, -np.inf))], "<f4").tobytes()
        if len(parts) > 1 and len(parts[1]) >= 4:
            at = 4 * rng.randrange(len(parts[1]) // 4)
            parts[1] = parts[1][:at] + data + parts[1][at + 4 :]
    return parts


def value(rng: random.Random) -> Any:
    """Something a field is not made for."""
    return rng.choice(
        (
            *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64 - 1, -(2**63)),
            *(float("nan"), float("inf"), -0.0, 1e308, "", "x" * 70000, b"bytes", b"\xff" * 10),
            *([], [[[[[[]]]]]], [1] * 2000, [2**40, 2**40], [-1], [0.5], {}, {"x": {"x": {}}}),
            *("f4", "O", "<f4", ">f8", "u1", [1, 2, 3], [1, 1, 1, 1, 1], "chunk", "SPB1"),
            [0, *[2**23] * 3],
            msgpack.ExtType(rng.randrange(127), b"x"),
            msgpack.Timestamp(0, 0),
        )
    )
