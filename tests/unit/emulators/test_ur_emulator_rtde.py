"""RTDE of the emulated controller: recipes, rates, registers in use, malformed packets."""

import os
import random
import struct
import tracemalloc

import pytest

from helpers.hardware.emulated_ur import Client, cycle, made, packets
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


TYPES = {
    "DOUBLE": "target_execution_time actual_robot_energy_consumed euromap67_24V_voltage "
    "actual_robot_braking_energy_dissipated euromap67_24V_current "
    "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
    "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 "
    "standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
    "tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar "
    "payload joint_position_deviation_ratio collision_detection_ratio output_double_register_47",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd "
    "actual_current actual_current_window joint_control_output actual_TCP_pose actual_TCP_speed "
    "actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage "
    "payload_inertia ft_raw_wrench tcp_offset actual_current_as_torque actual_TCP_acceleration "
    "target_TCP_acceleration wrench_calc_from_currents target_base_acceleration target_base_wrench",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog "
    "target_gravity",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage time_scale_source "
    "output_int_register_24 encoder0_raw encoder1_raw",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode "
    "tool_analog_input_types output_bit_registers0_to_31 output_bit_registers32_to_63 "
    "input_bit_registers0_to_31 input_bit_registers32_to_63 script_control_line "
    "euromap67_input_bits euromap67_output_bits",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits control_step "
    "actual_configurable_digital_input_bits actual_configurable_digital_output_bits",
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "BOOL": "output_bit_register_64 input_bit_register_127",
}
"""Types of fields that the maker's own client library expects (`ur_client_library`)."""
INPUT_TYPES = {
    "UINT32": "speed_slider_mask input_bit_registers0_to_31",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output "
    "configurable_digital_output_mask tool_digital_output standard_analog_output_mask "
    "standard_analog_output_type",
    "BOOL": "input_bit_register_64",
}


def test_the_fields_have_the_makers_types() -> None:
    for code, names in TYPES.items():
        assert {OUTPUTS[name][0] for name in names.split()} == {code}
    for code, names in INPUT_TYPES.items():
        assert {INPUTS[name] for name in names.split()} == {code}
    named = {name for names in TYPES.values() for name in names.split()}
    assert {name for name in OUTPUTS if "register" not in name} <= named, "a field without a type"
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


def test_protocol_version_1_has_no_numbers_and_no_rate() -> None:
    controller, client = connected()
    assert client.ask("O", b"timestamp,robot_mode") == [("O", b"DOUBLE,INT32")]
    assert client.ask("S") == [("S", b"\x01")]
    data = b"".join(client.session.output() for _ in range(8) if controller.advance() is None)
    got = [struct.unpack(">di", body) for _, body in packets(data)]
    assert got == [(0.008, 7), (0.016, 7)]  # 125 Hz


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
