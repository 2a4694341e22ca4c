"""Encodes and decodes the messages of policy and model server (docs/reference/protocol.md).

A message is a header and up to seven buffers, each a ZeroMQ frame. The header is ``SPB1``, one byte
for the kind, and a msgpack map. A buffer is the memory of an array, so pictures are neither copied
nor encoded. `decode` checks sizes, every key and type, and the length of each buffer against its
shape, before it allocates anything.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Sequence

import msgpack
import numpy as np
import zmq

from surg_policy_client import attention as sights
from surg_policy_client.attention import Attention, AttentionError
from surg_policy_client.header import Buffer, read_map
from surg_policy_client.wire_arrays import (
    MAX_PART,
    MAX_PARTS,
    WireError,
    array_of,
    bytes_of,
    check_arrays,
    check_values,
    dtype_name,
)
from surg_policy_client.wire_fields import FIELDS, KINDS, MAX_SENTENCE, wrong_field

MAGIC = b"SPB1"
VERSION = 2
"""Newest version of the protocol; HELLO offers a range, WELCOME selects one."""
TELLS = 2
"""Version from which on an ACT may say what the policy sees."""
MAX_HEADER = 1 << 20
"""[bytes] Largest header."""
_NAMES = {number: name for name, number in KINDS.items()}
_WITH_ARRAYS = ("OBS", "ACT")


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
    seen: Attention | None = None
    unseen: str = ""


def encode(message: Message) -> list[Buffer]:
    """Frames of a message, for `send_multipart`; buffers share the memory of the arrays.

    Raises:
        WireError: The message is invalid; a peer would refuse it.
    """
    if message.kind not in KINDS:
        raise WireError("kind", f"unknown kind {message.kind!r}")
    wrong = wrong_field(message.head, FIELDS[message.kind])
    if wrong:
        raise WireError(wrong[0], f"{message.kind}: {wrong[1]}")
    head = dict(message.head)
    buffers: list[Buffer] = []
    if message.kind in _WITH_ARRAYS:
        kept = {key: np.asarray(a, order="C") for key, a in message.arrays.items()}
        head["arrays"] = [
            {"key": key, "dtype": dtype_name(key, a), "shape": list(a.shape)}
            for key, a in kept.items()
        ]
        buffers = [bytes_of(a) for a in kept.values()]
        check_arrays(message.kind, head["arrays"], buffers)
        check_values(message.kind, kept)
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
    wrong = wrong_field(head, FIELDS[kind])
    if wrong:
        raise WireError(wrong[0], f"{kind}: {wrong[1]}")
    if (described is not None) != (kind in _WITH_ARRAYS):
        raise WireError("keys", f"{kind}: only {' and '.join(_WITH_ARRAYS)} have `arrays`")
    if described is None and len(views) > 1:
        raise WireError("parts", f"{kind} has {len(views)} frames; allowed: one")
    arrays: dict[str, np.ndarray] = {}
    if described is not None:
        check_arrays(kind, described, views[1:])
        arrays = {each["key"]: array_of(each, v) for each, v in zip(described, views[1:])}
        check_values(kind, arrays)
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


def _add_seen(seen: Attention, head: dict[str, Any], buffers: list[Buffer]) -> None:
    """Put what a policy sees into the header and the buffers of an ACT."""
    try:
        told, attention = sights.to_wire(seen)
    except AttentionError as error:
        raise WireError("field", f"ACT: {error}") from None
    arrays = head.pop("arrays")
    if attention is not None:
        arrays.append({"key": "attention", "dtype": "u1", "shape": list(attention.shape)})
        buffers.append(bytes_of(attention))
    head["seen"], head["arrays"] = told, arrays


def _taken_seen(told: Any, described: Any, views: Sequence[Any]) -> tuple[Attention | None, str]:
    """What an ACT says that the policy sees, or why that is dropped, without the actions."""
    try:
        attention = None
        if type(described) is list and len(described) > 1:
            check_arrays("OBS", described[1:], views[2:])
            if len(described) > 2 or described[1]["key"] != "attention":
                raise AttentionError("one array behind the chunk, `attention`")
            attention = array_of(described[1], views[2])
        elif len(views) > 2:
            raise AttentionError("a buffer without a description")
        return sights.from_wire(told, attention), ""
    except ValueError as error:  # AttentionError, WireError
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
