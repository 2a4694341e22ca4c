"""Encodes and decodes the messages of policy and model server (docs/reference/protocol.md).

A message is a header and up to seven buffers, each a ZeroMQ frame. The header is ``SPB1``, one byte
for the kind, and a msgpack map. A buffer is the memory of an array, so pictures are neither copied
nor encoded. `decode` checks sizes, every key and type, and the length of each buffer against its
shape, before it allocates anything.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Optional, Sequence

import msgpack
import numpy as np
import zmq

from surg_policy_client import seen as sights
from surg_policy_client.header import MAX_LIST, Buffer, read_map
from surg_policy_client.seen import Seen, SeenError
from surg_policy_client.spec import DTYPES, MAX_NDIM, Spec, SpecError

MAGIC = b"SPB1"
VERSION = 2
"""Newest version of the protocol; HELLO offers a range, WELCOME selects one."""
TELLS = 2
"""Version from which on an ACT may say what the policy sees."""
_KINDS = "HELLO WELCOME OBS ACT ACK PING PONG RESET EPISODE BYE ERR"
KINDS = {name: number for number, name in enumerate(_KINDS.split(), 1)}
"""Number of each kind in the header."""
EVENTS = ("begin", "end", "paused", "resumed")
"""Events of EPISODE."""

MAX_HEADER = 1 << 20
"""[bytes] Largest header."""
MAX_PART = 8 << 20
"""[bytes] Largest frame; both sides set it as ZeroMQ's MAXMSGSIZE."""
MAX_PARTS = 8
MAX_ROWS = MAX_LIST
"""Rows of a chunk. An empty chunk means that earlier rows stay valid."""
MAX_KEY = 128
MAX_SENTENCE = 1024
"""[characters] Longest instruction or reason."""


class WireError(ValueError):
    """An invalid message.

    Attributes:
        code: One of parts, size, magic, kind, header, keys, field, spec, dtype,
            shape, length, finite.
    """

    def __init__(self, code: str, text: str) -> None:
        super().__init__(f"{code}: {text}")
        self.code = code


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        kind: One of `KINDS`.
        head: Fields of the kind; ``wants`` and ``spec`` are maps of `Spec.to_map`.
        arrays: By key; decoded ones are read-only views of the frames.
        seen: Of an ACT: what the policy saw; None: it says nothing, or nothing valid.
        unseen: Why what it says was dropped; empty: it was not.
    """

    kind: str
    head: dict[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    seen: Seen | None = None
    unseen: str = ""


# --- fields ---------------------------------------------------------------------------------------

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
    return next((allowed for each in value if _wrong_field(each, _REJECTION)), None)


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
_FIELDS: dict[str, dict[str, Check]] = {
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
_NAMES = {number: name for name, number in KINDS.items()}
_WITH_ARRAYS = ("OBS", "ACT")


def _wrong_field(head: Any, fields: Mapping[str, Check]) -> tuple[str, str] | None:
    """Code and text of what is wrong with a map; None: nothing."""
    if type(head) is not dict or head.keys() != fields.keys():
        there = sorted(map(str, head)) if type(head) is dict else type(head).__name__
        return "keys", f"fields {str(there)[:200]}; allowed: exactly {', '.join(fields)}"
    for name, check in fields.items():
        allowed = check(head[name])
        if allowed is not None:
            return "spec" if name in ("wants", "spec") else "field", f"{name}: {allowed}"
    return None


# --- bytes ----------------------------------------------------------------------------------------


def encode(message: Message) -> list[Buffer]:
    """Frames of a message, for `send_multipart`; buffers share the memory of the arrays.

    Raises:
        WireError: The message is invalid; a peer would refuse it.
    """
    if message.kind not in KINDS:
        raise WireError("kind", f"unknown kind {message.kind!r}")
    wrong = _wrong_field(message.head, _FIELDS[message.kind])
    if wrong:
        raise WireError(wrong[0], f"{message.kind}: {wrong[1]}")
    head = dict(message.head)
    buffers: list[Buffer] = []
    if message.kind in _WITH_ARRAYS:
        kept = {key: np.asarray(a, order="C") for key, a in message.arrays.items()}
        head["arrays"] = [
            {"key": key, "dtype": _dtype_name(key, a), "shape": list(a.shape)}
            for key, a in kept.items()
        ]
        buffers = [_bytes_of(a) for a in kept.values()]
        _check_arrays(message.kind, head["arrays"], buffers)
        _check_values(message.kind, kept)
        if message.seen is not None:
            _add_seen(message.seen, head, buffers)
    elif message.arrays:
        raise WireError("keys", f"{message.kind} has no arrays")
    packed = MAGIC + bytes([KINDS[message.kind]]) + msgpack.packb(head)
    if len(packed) > MAX_HEADER:
        raise WireError("size", f"a header of {len(packed)} bytes; at most {MAX_HEADER}")
    return [packed, *buffers]


def decode(parts: Sequence[Any]) -> Message:
    """Message of frames (bytes, memoryviews, or pyzmq frames).

    Raises:
        WireError: The message is invalid.
    """
    if not 1 <= len(parts) <= MAX_PARTS:
        raise WireError("parts", f"{len(parts)} frames; a message has 1 to {MAX_PARTS}")
    views = [memoryview(getattr(part, "buffer", part)) for part in parts]
    if views[0].nbytes > MAX_HEADER or any(v.nbytes > MAX_PART for v in views):
        raise WireError("size", f"allowed: {MAX_HEADER} bytes of header, {MAX_PART} of a buffer")
    start = bytes(views[0][: len(MAGIC) + 1])
    if start[: len(MAGIC)] != MAGIC:
        raise WireError("magic", f"a header that begins with {start[:4]!r}, not {MAGIC!r}")
    kind = _NAMES.get(start[4]) if len(start) == 5 else None
    if kind is None:
        raise WireError("kind", f"unknown kind {list(start[4:])}")
    head = _unpacked(views[0][len(start) :])
    described = head.pop("arrays", None)
    seen, unseen = None, ""
    if kind == "ACT" and "seen" in head:
        seen, unseen = _taken_seen(head.pop("seen"), described, views)
        described, views = (described[:1] if type(described) is list else described), views[:2]
    wrong = _wrong_field(head, _FIELDS[kind])
    if wrong:
        raise WireError(wrong[0], f"{kind}: {wrong[1]}")
    if (described is not None) != (kind in _WITH_ARRAYS):
        raise WireError("keys", f"{kind}: only {' and '.join(_WITH_ARRAYS)} have `arrays`")
    if described is None and len(views) > 1:
        raise WireError("parts", f"{kind} has {len(views)} frames; allowed: one")
    arrays: dict[str, np.ndarray] = {}
    if described is not None:
        _check_arrays(kind, described, views[1:])
        arrays = {each["key"]: _array(each, v) for each, v in zip(described, views[1:])}
        _check_values(kind, arrays)
    return Message(kind, head, arrays, seen, unseen)


def receive(socket: Any, flags: int = 0, yield_cpu: Callable[[], None] = lambda: None) -> list[Any]:
    """Frames of the next message of a ZeroMQ socket; a ROUTER's first is the peer's identity.

    Keeps at most `MAX_PARTS` + 2 frames. The rest of a longer message is read and discarded, and
    `decode` refuses it.

    Args:
        socket: A pyzmq socket.
        flags: Of its ``recv``, such as ``zmq.NOBLOCK``.
        yield_cpu: Called every 256 discarded frames.
    """
    parts = [socket.recv(flags, copy=False)]
    while parts[-1].more and len(parts) < MAX_PARTS + 2:
        parts.append(socket.recv(copy=False))
    left, discarded = parts[-1].more, 0
    while left:  # recv with copy is twice as fast as an object for each frame
        socket.recv()
        left = socket.getsockopt(zmq.RCVMORE)
        discarded += 1
        if discarded % 256 == 0:
            yield_cpu()
    return parts


def _add_seen(seen: Seen, head: dict[str, Any], buffers: list[Buffer]) -> None:
    """Put what a policy sees into the header and the buffers of an ACT."""
    try:
        told, attention = sights.to_wire(seen)
    except SeenError as error:
        raise WireError("field", f"ACT: {error}") from None
    arrays = head.pop("arrays")
    if attention is not None:
        arrays.append({"key": "attention", "dtype": "u1", "shape": list(attention.shape)})
        buffers.append(_bytes_of(attention))
    head["seen"], head["arrays"] = told, arrays


def _taken_seen(told: Any, described: Any, views: Sequence[Any]) -> tuple[Seen | None, str]:
    """What an ACT says that the policy sees, or why that is dropped, without the actions."""
    try:
        attention = None
        if type(described) is list and len(described) > 1:
            _check_arrays("OBS", described[1:], views[2:])
            if len(described) > 2 or described[1]["key"] != "attention":
                raise SeenError("one array behind the chunk, `attention`")
            attention = _array(described[1], views[2])
        elif len(views) > 2:
            raise SeenError("a buffer without a description")
        return sights.from_wire(told, attention), ""
    except ValueError as error:  # SeenError, WireError
        return None, str(error)[:MAX_SENTENCE]


def _unpacked(data: memoryview) -> dict[str, Any]:
    """The header's map."""
    try:
        return read_map(data)
    # msgpack raises ValueErrors; whatever else it raises must not end a server either.
    except Exception as error:
        raise WireError(
            "header", f"not a msgpack map: {type(error).__name__} {error}"[:300]
        ) from None


def _check_arrays(kind: str, described: Any, buffers: Sequence[Any]) -> None:
    """Check the descriptions against the lengths of the buffers, without allocating."""
    if type(described) is not list or len(described) != len(buffers):
        raise WireError("parts", f"{kind}: a description for each of {len(buffers)} buffers")
    if len(described) > MAX_PARTS - 1:
        raise WireError("parts", f"{kind}: {len(described)} arrays; at most {MAX_PARTS - 1}")
    seen = set()
    for item, buffer in zip(described, buffers):
        if type(item) is not dict or item.keys() != {"key", "dtype", "shape"}:
            raise WireError("keys", f"{kind}: an array has exactly key, dtype, shape")
        key, dtype, shape = item["key"], item["dtype"], item["shape"]
        if type(key) is not str or not 0 < len(key) <= MAX_KEY or key in seen:
            raise WireError("field", f"{kind}: keys of 1 to {MAX_KEY} characters, each once")
        seen.add(key)
        if type(dtype) is not str or dtype not in DTYPES:
            raise WireError("dtype", f"{key}: one of {', '.join(DTYPES)}, not {dtype!r:.40}")
        if (
            type(shape) is not list
            or len(shape) > MAX_NDIM
            or any(type(side) is not int or not 0 <= side <= MAX_PART for side in shape)
        ):
            raise WireError("shape", f"{key}: at most {MAX_NDIM} sides of 0 to {MAX_PART}")
        # With a side of 0 the size is 0, but numpy still multiplies the other sides.
        size = room = np.dtype(DTYPES[dtype]).itemsize
        for side in shape:
            size, room = size * side, room * max(side, 1)
        length = memoryview(buffer).nbytes
        if size != length:
            raise WireError("length", f"{key}: {dtype} {shape} has {size} bytes, not {length}")
        if room > MAX_PART:
            raise WireError("size", f"{key}: {dtype} {shape}: {room} bytes; at most {MAX_PART}")
    if kind == "ACT":
        good = [each["key"] for each in described] == ["chunk"]
        good = good and described[0]["dtype"] in ("f4", "f8") and len(described[0]["shape"]) == 2
        if not (good and described[0]["shape"][0] <= MAX_ROWS):
            raise WireError("shape", f"ACT: one array `chunk`, f4 or f8, [0 to {MAX_ROWS}, A]")


def _check_values(kind: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Check the values: finite actions, booleans of 0 or 1."""
    for key, array in arrays.items():
        if kind == "ACT" and not np.isfinite(array).all():
            raise WireError("finite", f"{key}: actions are finite numbers")
        if array.dtype == np.bool_ and array.size and int(array.view(np.uint8).max()) > 1:
            raise WireError("field", f"{key}: b1 is 0 or 1")


def _dtype_name(key: str, array: np.ndarray) -> str:
    name = array.dtype.str[1:]
    if name not in DTYPES:
        allowed = ", ".join(np.dtype(each).name for each in DTYPES.values())
        raise WireError("dtype", f"{key}: type {array.dtype}; allowed: {allowed}")
    return name


def _bytes_of(array: np.ndarray) -> Buffer:
    """Memory of the array, little-endian."""
    if array.dtype.byteorder == ">" or (array.dtype.byteorder == "=" and not _LITTLE):
        array = array.astype(array.dtype.newbyteorder("<"))
    return array.data.cast("B") if array.size else b""


def _array(described: Mapping[str, Any], view: memoryview) -> np.ndarray:
    dtype = np.dtype(DTYPES[described["dtype"]]).newbyteorder("<")
    flat = np.frombuffer(view, dtype) if view.nbytes else np.empty(0, dtype)
    # ZeroMQ puts small frames at unaligned addresses, which some libraries cannot read.
    flat = flat if flat.flags.aligned else flat.copy()
    shaped = flat.reshape(described["shape"])
    shaped.flags.writeable = False
    return shaped


_LITTLE = np.dtype("<i4").isnative
