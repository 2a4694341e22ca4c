"""The codec of the policies' wire: what goes in comes out, and nothing else is believed."""

import random
import re
import resource
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq

from helpers.policy import policy_messages
from helpers.policy.policy_server import spec
from helpers.results.policy_results import note
from surg_cli.host import paths
from surg_policy_client import wire
from surg_policy_client.wire import Message, WireError, decode, encode
from surg_policy_client.wire_fields import FIELDS, KINDS

PAGE = paths.ROOT / "docs" / "reference" / "protocol.md"


def same_map(a: Message, b: Message) -> bool:
    """Whether both say the same map of what a policy looks at, or none."""
    first, second = (m.seen.heat_map if m.seen is not None else None for m in (a, b))
    return np.array_equal(
        np.zeros(0) if first is None else first, np.zeros(0) if second is None else second
    )


def same(a: Message, b: Message) -> bool:
    """Whether two messages are equal to the bit."""
    return (
        (a.kind, a.head, a.seen, a.unseen) == (b.kind, b.head, b.seen, b.unseen)
        and same_map(a, b)
        and list(a.arrays) == list(b.arrays)
        and all(
            x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()
            for x, y in zip(a.arrays.values(), b.arrays.values(), strict=True)
        )
    )


def test_what_goes_in_comes_out(rng: random.Random, full: bool) -> None:
    count = 1_000 if full else 60
    for kind in KINDS:
        for _ in range(count):
            message = policy_messages.draw(rng, kind)
            parts = encode(message)
            plain = [bytes(part) for part in parts]
            for frames in (parts, [zmq.Frame(p) for p in plain], [memoryview(p) for p in plain]):
                assert same(decode(frames), message)
            assert [bytes(part) for part in encode(decode(parts))] == plain
    note(8, count * len(KINDS), "equal to the bit")


def test_arrays_in_any_memory_order_arrive_as_they_are() -> None:
    picture = np.arange(60, dtype=np.uint8).reshape(3, 4, 5)
    head = policy_messages.draw(random.Random(1), "OBS").head
    arrays = {
        "turned": picture.transpose(2, 0, 1),
        "every second": picture[:, ::2],
        "backwards": picture[::-1],
        "big": np.arange(3, dtype=">f8"),
        "number": np.array(2.5),
    }
    found = decode(encode(Message("OBS", head, arrays))).arrays
    assert list(found) == list(arrays)
    assert all(np.array_equal(found[key], arrays[key]) for key in arrays)
    assert found["big"].dtype == "<f8"


def test_pictures_are_not_copied() -> None:
    picture = np.zeros((480, 640, 3), np.uint8)
    head = policy_messages.draw(random.Random(1), "OBS").head
    parts = encode(Message("OBS", head, {"picture": picture}))
    assert np.shares_memory(np.frombuffer(parts[1], np.uint8), picture)
    found = decode(parts).arrays["picture"]
    assert np.shares_memory(found, picture)
    assert not found.flags.writeable


def test_arrays_at_odd_addresses_are_usable() -> None:
    data = np.arange(5.0)
    odd = memoryview(b"x" + data.tobytes())[1:]
    head = policy_messages.draw(random.Random(1), "OBS").head
    parts = encode(Message("OBS", head, {"state": data}))
    found = decode([parts[0], odd]).arrays["state"]
    assert found.flags.aligned
    assert np.array_equal(found, data)


# --- the page -------------------------------------------------------------------------------------


def blocks(text: str) -> list[bytes]:
    """Bytes of the page's hexadecimal blocks: the first column, what follows `;` is comment."""
    found = re.findall(r"```hex\n(.*?)```", text, re.DOTALL)
    return [bytes.fromhex("".join(x.split(";")[0] for x in b.splitlines())) for b in found]


def test_the_page_shows_real_bytes() -> None:
    ping, act_header, act_buffer = blocks(PAGE.read_text("utf-8"))
    assert decode([ping]) == Message("PING", {"session": 0x0123456789ABCDEF, "n": 7})
    assert encode(decode([ping])) == [ping]
    act = decode([act_header, act_buffer])
    assert act.head == {"session": 1, "seq": 7, "stamp_ns": 350_000_000, "step0": 8}
    assert act.arrays["chunk"].tolist() == [[0.0, 0.0, 0.125, 0.0, 0.5]]
    assert [bytes(p) for p in encode(act)] == [act_header, act_buffer]


def test_the_page_names_every_kind_field_and_limit() -> None:
    text = PAGE.read_text("utf-8")
    for kind, number in KINDS.items():
        row = next(x for x in text.splitlines() if x.startswith(f"| {number} | {kind} "))
        for name in FIELDS[kind]:
            assert f"`{name}`" in row, (kind, name)
    for name, value in (("header", wire.MAX_HEADER), ("frame", wire.MAX_PART)):
        assert f"{value:,}" in text, name


# --- what is refused ------------------------------------------------------------------------------

ACT: dict[str, Any] = {"session": 1, "seq": 1, "stamp_ns": 1, "step0": 1}
CHUNK = np.zeros((2, 5), "<f4").tobytes()


def act(**described: Any) -> list[bytes]:
    """An ACT of 2 rows of 5 with something else in its description."""
    each = {"key": "chunk", "dtype": "f4", "shape": [2, 5], **described}
    return [policy_messages.pack(4, {**ACT, "arrays": [each]}), CHUNK]


def ping(**head: Any) -> list[bytes]:
    return [policy_messages.pack(6, {"session": 1, "n": 1, **head})]


def obs(arrays: Any, *buffers: bytes) -> list[bytes]:
    head = {**policy_messages.draw(random.Random(1), "OBS").head, "arrays": arrays}
    return [policy_messages.pack(3, head), *buffers]


VAST = [0, 2**23, 2**23, 2**23]
ONE = {"key": "a", "dtype": "u1", "shape": [1]}
TWINS = wire.MAGIC + b"\x06\x82" + msgpack.packb("n") + b"\x01" + msgpack.packb("n") + b"\x02"
REFUSED: dict[str, tuple[str, list[bytes]]] = {
    "no frame": ("parts", []),
    "nine frames": ("parts", [*ping(), *[b""] * 8]),
    "an empty frame": ("magic", [b""]),
    "another protocol": ("magic", [b"SPB2" + ping()[0][4:]]),
    "magic alone": ("kind", [b"SPB1"]),
    "an unknown kind": ("kind", [b"SPB1\x63\x80"]),
    "no map": ("header", [b"SPB1\x06"]),
    "a list": ("header", [policy_messages.pack(6, [1, 2])]),
    "bytes behind the map": ("header", [ping()[0] + b"\x00"]),
    "a map that ends early": ("header", [ping()[0][:-1]]),
    "a key twice": ("header", [TWINS]),
    "a key that is a number": ("header", [policy_messages.pack(6, {1: 1})]),
    "text that is no UTF-8": ("header", [wire.MAGIC + b"\x06\x81\xa1\xff\x01"]),
    "bytes for text": ("header", [policy_messages.pack(10, {"session": 1, "reason": b"x"})]),
    "an extension": ("header", ping(n=msgpack.ExtType(5, b"x"))),
    "a time stamp": ("header", ping(n=msgpack.Timestamp(1, 1))),
    "a list that claims to be long": ("header", [wire.MAGIC + b"\x06\xdd\xff\xff\xff\xff"]),
    "a map that claims to be long": ("header", [wire.MAGIC + b"\x06\xdf\xff\xff\xff\xff"]),
    "a list over the limit": ("header", ping(n=[1] * 1025)),
    "a map over the limit": ("header", ping(n={str(i): 1 for i in range(257)})),
    "a text over the limit": ("header", ping(n="x" * 65537)),
    "a depth bomb of lists": ("header", [wire.MAGIC + b"\x06" + b"\x91" * 100_000]),
    "a depth bomb of maps": ("header", [wire.MAGIC + b"\x06" + b"\x81\xa1x" * 300_000]),
    "a header over the limit": ("size", [wire.MAGIC + b"\x06" + b"\0" * wire.MAX_HEADER]),
    "a buffer over the limit": ("size", [act()[0], b"\0" * (wire.MAX_PART + 1)]),
    "a field too many": ("keys", ping(x=1)),
    "a field missing": ("keys", [policy_messages.pack(6, {"session": 1})]),
    "no session": ("field", ping(session=0)),
    "a session over 64 bits": ("field", ping(session=-1)),
    "true for a number": ("field", ping(n=True)),
    "a fraction for a count": ("field", ping(n=1.0)),
    "text for a number": ("field", ping(n="1")),
    "a text too long": ("field", [policy_messages.pack(10, {"session": 1, "reason": "x" * 1025})]),
    "a buffer with a PING": ("parts", [*ping(), b""]),
    "arrays with a PING": ("keys", ping(arrays=[])),
    "an ACT without arrays": ("keys", [policy_messages.pack(4, ACT)]),
    "an ACT without its buffer": ("parts", act()[:1]),
    "an ACT with two buffers": ("parts", [*act(), b""]),
    "an ACT of another name": ("shape", act(key="chunks")),
    "an ACT of bytes": ("shape", [act(dtype="u1", shape=[2, 20])[0], CHUNK]),
    "an ACT of one dimension": ("shape", act(shape=[10])),
    "an ACT of three dimensions": ("shape", act(shape=[1, 2, 5])),
    "an ACT of 1025 rows": ("shape", [act(shape=[1025, 1])[0], b"\0" * 4100]),
    "an object array": ("dtype", act(dtype="O")),
    "a big-endian array": ("dtype", act(dtype=">f4")),
    "a half-precision array": ("dtype", act(dtype="f2")),
    "a dtype that is no text": ("dtype", act(dtype=1)),
    "a shape that lies, too large": ("length", act(shape=[2, 6])),
    "a shape that lies, too small": ("length", act(shape=[2, 4])),
    "a shape beyond memory": ("length", act(shape=[1024, 2**20])),
    "a side beyond the limit": ("shape", act(shape=[2, 2**62])),
    "a negative side": ("shape", act(shape=[-2, -5])),
    "sides that overflow to the length": ("shape", act(shape=[2**33, 2**33])),
    "a side of 0 beside sides beyond memory": ("size", obs([{**ONE, "shape": VAST}], b"")),
    "a side that is true": ("shape", act(shape=[True, 10])),
    "a shape that is no list": ("shape", act(shape="25")),
    "five dimensions": ("shape", obs([{**ONE, "shape": [1] * 5}], b"x")),
    "a description too many": ("parts", obs([ONE, {**ONE, "key": "b"}], b"x")),
    "a description too few": ("parts", obs([], b"x")),
    "a description that is no map": ("keys", obs([1], b"x")),
    "a description with a key more": ("keys", obs([{**ONE, "order": "F"}], b"x")),
    "the same array twice": ("field", obs([ONE, ONE], b"x", b"x")),
    "an array without a name": ("field", obs([{**ONE, "key": ""}], b"x")),
    "a truth value of 2": ("field", obs([{**ONE, "dtype": "b1"}], b"\x02")),
    "NaN in an action": ("finite", [act()[0], np.full((2, 5), np.nan, "<f4").tobytes()]),
    "infinity in an action": ("finite", [act()[0], np.full((2, 5), np.inf, "<f4").tobytes()]),
    "a spec that is none": (
        "spec",
        [
            policy_messages.pack(
                1,
                {
                    **policy_messages.draw(random.Random(1), "HELLO").head,
                    "wants": {**spec().to_map(), "period_s": float("nan")},
                },
            )
        ],
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what: str) -> None:
    code, parts = REFUSED[what]
    with pytest.raises(WireError) as caught:
        decode(parts)
    assert caught.value.code == code, caught.value
    assert len(str(caught.value)) < 1000
    assert decode(ping()).head["n"] == 1  # and a good one passes right after


def test_every_way_to_be_wrong_has_its_reason() -> None:
    reasons = {code for code, _ in REFUSED.values()}
    note(9, len(REFUSED), f"{len(reasons)} reasons")
    assert len(reasons) == 12


def test_nothing_is_set_aside_for_what_a_header_claims() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for what in ("a list that claims to be long", "a shape beyond memory", "a depth bomb of maps"):
        for _ in range(20):
            with pytest.raises(WireError):
                decode(REFUSED[what][1])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 32 * 1024  # KiB


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (Message("PINGS", {}), "kind"),
        (Message("PING", {"session": 1}), "keys"),
        (Message("PING", {"session": 1, "n": 1}, {"x": np.zeros(1)}), "keys"),
        (Message("ACT", ACT, {"chunk": np.full((1, 5), np.nan)}), "finite"),
        (Message("ACT", ACT, {"chunk": np.zeros((1, 5), np.int32)}), "dtype"),
        (Message("ACT", ACT, {"chunk": np.array([["x"]], dtype=object)}), "dtype"),
        (Message("BYE", {"session": 1, "reason": "x" * 2000}), "field"),
    ],
)
def test_what_a_peer_would_refuse_never_goes_out(message: Message, code: str) -> None:
    with pytest.raises(WireError) as caught:
        encode(message)
    assert caught.value.code == code


# --- strangers ------------------------------------------------------------------------------------


def test_fuzz(rng: random.Random, full: bool) -> None:
    """Whatever comes: a message, or a WireError; and a good message passes in between."""
    count = 100_000 if full else 4_000
    codes: dict[str, int] = {}
    good = policy_messages.draw(random.Random(2), "ACT")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for i in range(count):
        parts = policy_messages.spoil(rng, [bytes(p) for p in encode(policy_messages.draw(rng))])
        try:
            message = decode(parts)
        except WireError as error:
            codes[error.code] = codes.get(error.code, 0) + 1
        else:
            codes["good"] = codes.get("good", 0) + 1
            assert np.isfinite(message.arrays.get("chunk", np.zeros(1))).all()
            encode(message)  # what was believed can be said again
        if i % 100 == 0:
            assert same(decode(encode(good)), good)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(", ".join(f"{code} {n:,}" for code, n in sorted(codes.items())))
    note(10, count, f"{codes['good']} good, {grown:.0f} MiB of growth; nothing else was raised")
    expected = {"good", "header", "magic", "kind", "keys", "field", "parts", "length", "finite"}
    assert expected <= set(codes)
    assert codes["good"] < 0.6 * count
    assert grown < 64


# --- frames off a socket --------------------------------------------------------------------------


def test_a_flood_of_frames_is_let_go() -> None:
    context = zmq.Context()
    with context.socket(zmq.ROUTER) as server, context.socket(zmq.DEALER) as client:
        server.bind("inproc://here")
        client.connect("inproc://here")
        client.send_multipart([b"x"] * 20_000)
        client.send_multipart(encode(policy_messages.draw(random.Random(3), "ACT")))
        given = []
        flood = wire.receive(server, yield_cpu=lambda: given.append(1))
        assert len(flood) == wire.MAX_PARTS + 2
        assert len(given) > 20_000 // 300, "nobody else had a turn meanwhile"
        with pytest.raises(WireError, match="frames"):
            decode(flood[1:])
        assert decode(wire.receive(server)[1:]).kind == "ACT"
        with pytest.raises(zmq.Again):
            wire.receive(server, zmq.NOBLOCK)
    context.term()
