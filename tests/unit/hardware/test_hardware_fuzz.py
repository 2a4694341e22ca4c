"""Broken RTDE streams, recipes and datagrams: an error or nothing, never a hang or a crash."""

from __future__ import annotations

import os
import resource
import socket
import struct
import threading

import numpy as np
import pytest

from helpers.results.hardware_results import FUZZ_DATAGRAMS, FUZZ_STATES, note
from surg_hardware import driver_datagrams as wire
from surg_hardware.conditions import Condition
from surg_hardware.robot_adapter import ArmIdentity
from surg_hardware.robot_link import Status
from surg_hardware.ur import rtde
from surg_hardware.ur.rtde import Decoder, Recipe, Rtde, RtdeError, RtdeRefused

COUNT = 1_000_000 if os.environ.get("SURG_TEST_FULL") == "1" else 20_000
TYPES = "DOUBLE,VECTOR6D,INT32,UINT32,VECTOR3D,BOOL,UINT8,UINT64,VECTOR6INT32,VECTOR6UINT32"
NAMES = [f"field_{n}" for n in range(10)]


def memory() -> int:
    """Largest resident set so far [kB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def test_a_stream_is_split_the_same_wherever_it_is_cut() -> None:
    rng = np.random.default_rng(4)
    bodies = [rng.bytes(int(n)) for n in rng.integers(0, 300, 200)]
    stream = b"".join(struct.pack(">HB", 3 + len(b), k % 256) + b for k, b in enumerate(bodies))
    for size in (1, 2, 7, 100, 5000):
        decoder, found = Decoder(), []
        for at in range(0, len(stream), size):
            found += decoder.add(stream[at : at + size])
        assert found == [(k % 256, body) for k, body in enumerate(bodies)]


@pytest.mark.parametrize("length", [0, 1, 2])
def test_a_length_that_cannot_be_is_an_error(length: int) -> None:
    with pytest.raises(RtdeError):
        Decoder().add(struct.pack(">HB", length, ord("U")))


def test_fuzzed_streams_and_states() -> None:
    """Random bytes, true packages, cut and changed ones; memory stays flat."""
    rng = np.random.default_rng(5)
    recipe = Recipe.of(NAMES, b"\x01" + TYPES.encode())
    good = b"\x01" + rng.bytes(recipe.layout.size)
    decoder, errors, states, before = Decoder(), 0, 0, 0
    for k in range(COUNT):
        if k == COUNT // 10:
            before = memory()
        body = bytearray(good)
        for _ in range(int(rng.integers(0, 3))):
            body[int(rng.integers(len(body)))] = int(rng.integers(256))
        cut = bytes(body[: int(rng.integers(len(body) + 1))]) if rng.random() < 0.3 else bytes(body)
        data = struct.pack(">HB", 3 + len(cut), ord("U")) + cut
        if rng.random() < 0.1:
            short = struct.pack(">H", int(rng.integers(3)))
            data = (short if rng.random() < 0.5 else b"") + rng.bytes(int(rng.integers(1, 64)))
        if k % 50 == 0:  # a new connection
            decoder = Decoder()
        try:
            for _, payload in decoder.add(data):
                states += recipe.unpack(payload) is not None
        except RtdeError:
            errors += 1
            decoder = Decoder()
    assert errors > 0 and states > COUNT // 20
    more = memory() - before
    assert more < 20_000
    note(FUZZ_STATES, COUNT, f"{states} states, {errors} errors, {more} kB more memory")


@pytest.mark.parametrize(
    "reply",
    [b"", b"\x01", b"\x01DOUBLE", b"\x01" + b",".join([b"DOUBLE"] * 11), b"\xff\xff\xfe" * 3],
)
def test_an_answer_to_other_fields_is_an_error(reply: bytes) -> None:
    with pytest.raises(RtdeError):
        Recipe.of(NAMES, reply)


@pytest.mark.parametrize("word", ["NOT_FOUND", "IN_USE"])
def test_a_field_that_is_refused_is_named(word: str) -> None:
    reply = b"\x00" + ",".join(["DOUBLE"] * 9 + [word]).encode()
    with pytest.raises(RtdeRefused, match=f"field_9 {word}"):
        Recipe.of(NAMES, reply)


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"\x00\x00V",
        b"\x00\x04V\x00",
        b"HTTP/1.1 200 OK\r\n\r\n",
        struct.pack(">HB", 65535, ord("M")) + b"\0" * 65532,
        struct.pack(">HB", 4, ord("V")) + b"\x01" + struct.pack(">HB", 5, ord("v")) + b"12",
    ],
)
def test_a_peer_that_speaks_no_rtde_is_an_error_within_the_time_out(
    answer: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(rtde, "PORT", server.getsockname()[1])

        def serve() -> None:
            peer = server.accept()[0]
            peer.sendall(answer)
            if not answer:
                peer.recv(100)
            peer.close()

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(OSError):
            Rtde("127.0.0.1", timeout=0.3)
        thread.join(5.0)


STATUS = Status(Condition.STOPPED, "protective stop: unlock it", True, 17, 0.5)
UPWARDS = (
    wire.StateDatagram(12, 34, (0.1,) * 6, (-0.2,) * 6, STATUS),
    wire.StateDatagram(0, 0, (), (), STATUS),
    wire.StateDatagram(12, 34, (0.1,) * 7, (-0.2,) * 7, STATUS, (1.0, -2.0, 3.0, 0.1, 0.2, 0.3)),
    wire.IdentityDatagram((0.3,) * 7, ArmIdentity("UR5", (0.1,) * 12, "12", 0.85, (0, 0.02, 0.11))),
    wire.IdentityDatagram((0.3,) * 7, ArmIdentity("fr3", (0.1,) * 12)),
    wire.NoticeDatagram("start: it is not in remote control"),
)
DOWNWARDS = (wire.CommandDatagram(5, (0.1, -3.0)), wire.RequestDatagram("start", True))


def test_datagrams_come_back_as_they_were() -> None:
    for message in UPWARDS:
        assert wire.decode_from_driver(message.pack()) == message
        assert len(message.pack()) <= wire.LONGEST
    for each in DOWNWARDS:
        assert wire.decode_to_driver(each.pack()) == each


def test_a_command_of_too_many_joints_has_none() -> None:
    assert wire.decode_to_driver(wire.CommandDatagram(1, (0.0,) * 9).pack()).qd == ()  # type: ignore[union-attr]


def test_a_long_sentence_is_cut() -> None:
    said = wire.decode_from_driver(wire.NoticeDatagram("ä" * 1000).pack())
    assert isinstance(said, wire.NoticeDatagram) and 190 < len(said.text) <= 201


def test_fuzzed_datagrams_are_read_or_refused() -> None:
    rng = np.random.default_rng(6)
    packed = [message.pack() for message in (*UPWARDS, *DOWNWARDS)]
    read, refused, before = 0, 0, 0
    for k in range(COUNT):
        if k == COUNT // 10:
            before = memory()
        data = bytearray(packed[int(rng.integers(len(packed)))])
        for _ in range(int(rng.integers(0, 4))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        raw = bytes(data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.3 else data)
        for decode in (wire.decode_from_driver, wire.decode_to_driver):
            try:
                message = decode(raw)
            except wire.DatagramError:
                refused += 1
                continue
            read += 1
            if isinstance(message, wire.StateDatagram | wire.CommandDatagram):
                assert len(message.qd) <= wire.MOST_JOINTS
    assert read > COUNT // 2 and refused > COUNT // 2
    more = memory() - before
    assert more < 20_000
    note(FUZZ_DATAGRAMS, COUNT, f"{read} read, {refused} refused, {more} kB more memory")
