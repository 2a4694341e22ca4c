"""RTDE of the emulated controller: recipes, rates, registers in use, malformed packets."""

import os
import random
import struct
import tracemalloc

import pytest

from helpers.hardware.emulated_ur import Client, cycle, made
from helpers.results.hardware_results import FUZZ_SERVER, note
from surg_emulators.ur.rtde_fields import INPUTS, OUTPUTS
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import VERSIONS, UrController

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
PACKETS = 1_000_000 if FULL else 30_000
MEMORY = 2_000_000
"""The emulator may keep this much after all packets [bytes]."""


def connected() -> tuple[UrController, Client]:
    controller = UrController()
    return controller, Client(RtdeSession(controller))


def test_versions_are_told() -> None:
    _, client = connected()
    assert client.ask("V", b"\x00\x03") == [("V", b"\x00")]
    assert client.ask("V", b"\x00\x02") == [("V", b"\x01")]
    assert client.ask("v") == [("v", struct.pack(">4I", *VERSIONS["5"]))]


def test_every_output_can_be_asked_for_and_is_in_the_state() -> None:
    controller, client = connected()
    for name in OUTPUTS:
        client = Client(RtdeSession(controller))
        client.set_up([name])
        assert name in cycle(controller, client)
    assert len(OUTPUTS) > 400


@pytest.mark.parametrize(
    ("name", "code"),
    {
        "target_execution_time": "DOUBLE",
        "tool_temperature": "DOUBLE",
        "output_double_register_47": "DOUBLE",
        "wrench_calc_from_currents": "VECTOR6D",
        "target_gravity": "VECTOR3D",
        "joint_mode": "VECTOR6INT32",
        "encoder1_raw": "INT32",
        "output_int_register_24": "INT32",
        "script_control_line": "UINT32",
        "euromap67_output_bits": "UINT32",
        "control_step": "UINT64",
        "tool_output_mode": "UINT8",
        "output_bit_register_64": "BOOL",
    }.items(),
)
def test_the_fields_have_the_makers_types(name: str, code: str) -> None:
    """One of each kind; `test_ur_client_library_oracle.py` asks for all of them."""
    assert OUTPUTS[name][0] == code
    assert "input_bit_register_63" not in INPUTS


def test_unknown_fields_are_not_found_and_the_recipe_is_invalid() -> None:
    _, client = connected()
    client.ask("V", b"\x00\x02")
    body = struct.pack(">d", 500.0) + b"timestamp,nothing"
    assert client.ask("O", body) == [("O", b"\x00DOUBLE,NOT_FOUND")]
    assert client.ask("I", b"nothing") == [("I", b"\x00NOT_FOUND")]
    assert client.ask("S") == [("S", b"\x00")]


def test_an_input_of_another_client_is_in_use_until_it_leaves() -> None:
    controller, first = connected()
    first.set_up(["timestamp"], ["input_int_register_24"])
    second = Client(RtdeSession(controller))
    second.ask("V", b"\x00\x02")
    names = b"input_int_register_24,input_int_register_25"
    assert second.ask("I", names) == [("I", b"\x00IN_USE,INT32")]
    first.session.leave()
    assert second.ask("I", names) == [("I", b"\x01INT32,INT32")]


@pytest.mark.parametrize(("rate", "states"), [(500.0, 100), (125.0, 25), (1.0, 0), (333.0, 50)])
def test_states_come_at_the_rate_that_was_asked_for(rate: float, states: int) -> None:
    controller, client = connected()
    client.set_up(["timestamp"], rate=rate)
    got = [cycle(controller, client) for _ in range(100)]
    assert sum(bool(state) for state in got) == states


@pytest.mark.parametrize("rate", [0.0, -1.0, 501.0, float("nan"), float("inf")])
def test_other_rates_are_refused(rate: float) -> None:
    _, client = connected()
    client.ask("V", b"\x00\x02")
    answers = client.ask("O", struct.pack(">d", rate) + b"timestamp")
    assert [kind for kind, _ in answers] == ["M", "O"]
    assert answers[-1][1] == b"\x00"


def test_pause_and_start() -> None:
    controller, client = connected()
    client.set_up(["timestamp"])
    assert cycle(controller, client)
    assert client.ask("P") == [("P", b"\x01")]
    assert not cycle(controller, client)
    assert client.ask("S") == [("S", b"\x01")]
    assert cycle(controller, client)


def test_packets_may_arrive_byte_by_byte() -> None:
    _, whole = connected()
    _, pieces = connected()
    stream = (
        made("V", b"\x00\x02")
        + made("O", struct.pack(">d", 500.0) + b"timestamp,actual_q")
        + made("I", b"input_int_register_24")
        + made("S")
        + made("U", b"\x01" + struct.pack(">i", 5))
    )
    at_once = whole.session.receive(stream)
    assert at_once == b"".join(pieces.session.receive(bytes([b])) for b in stream)
    assert not whole.session.closed
    assert not pieces.session.closed


def test_too_long_lists_of_names_are_refused() -> None:
    _, client = connected()
    client.ask("V", b"\x00\x02")
    names = ",".join(f"input_int_register_{n}" for n in range(48)) + ","
    assert client.ask("I", (names * 3).encode()[:2049]) == [("I", b"\x00")]


@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_size_below_the_header_ends_the_connection(size: int) -> None:
    _, client = connected()
    assert client.session.receive(struct.pack(">HB", size, ord("U")) + b"abc") == b""
    assert client.session.closed


def test_wrong_data_is_told_and_changes_nothing() -> None:
    controller, client = connected()
    number = client.set_up(["timestamp"], ["input_int_register_24"])
    client.send(number, 5)
    cycle(controller)
    for body in (b"", b"\x09\x00\x00\x00\x01", b"\x01", b"\x01" + b"\x00" * 9):
        assert [kind for kind, _ in client.ask("U", body)] == ["M"]
    assert [kind for kind, _ in client.ask("Z")] == ["M"]
    cycle(controller)
    assert controller.inputs["int"][24] == 5
    assert not client.session.closed


def random_packet(generator: random.Random) -> bytes:
    """A packet with a wrong size, type or body, or a good one."""
    names = [*generator.sample(sorted(INPUTS), 2), generator.choice(sorted(OUTPUTS)), "x"]
    body = generator.choice(
        [
            generator.randbytes(generator.randrange(40)),
            ",".join(names[: generator.randrange(5)]).encode(),
            struct.pack(">d", generator.choice([500.0, -1.0, float("nan")])) + names[2].encode(),
            bytes([generator.randrange(4)]) + generator.randbytes(generator.randrange(9)),
            b"\x00\x02",
        ]
    )
    kind = generator.choice("VvMUOISPU")
    packet = bytearray(made(kind, body))
    if generator.random() < 0.1:
        packet[generator.randrange(min(3, len(packet)))] = generator.randrange(256)
    return bytes(packet)


def test_fuzzed_packets_leave_controller_and_memory_as_they_were() -> None:
    generator, controller = random.Random(7), UrController()
    client, restarts = Client(RtdeSession(controller)), 0
    tracemalloc.start()
    for count in range(PACKETS):
        if count == PACKETS // 10:
            before = tracemalloc.get_traced_memory()[0]
        data = random_packet(generator)
        client.session.receive(data[: generator.choice([len(data), len(data), 2])])
        if client.session.closed or count % 500 == 499:
            client.session.leave()
            client, restarts = Client(RtdeSession(controller)), restarts + 1
        if count % 4 == 0:
            controller.advance()
            client.session.output()
            controller.execute()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    note(FUZZ_SERVER, PACKETS, f"{restarts} connections, {grown / 1e3:.1f} kB more memory")
    assert grown < MEMORY
    client.session.leave()
    assert controller.claims == {}
    assert controller.motion.at_rest
