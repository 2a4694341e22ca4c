"""Emulated servos, judged by the maker's SDK: frames, instructions, a pseudo-terminal."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupSyncRead,
    GroupSyncWrite,
)
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from helpers.hardware.servo_bench import MemoryPort, with_terminals
from surg_emulators.drive import servo_motor
from surg_emulators.drive.drive_emulator import DriveEmulator
from surg_emulators.drive.servo_frames import HEADER, Frame, FrameParser, encode, status
from surg_emulators.drive.servo_line import ServoLine
from surg_emulators.drive.servo_motor import Servo
from surg_hardware.drive.serial_port import SerialPort

SDK = Protocol2PacketHandler()
ALERT = 0x80
MARK = HEADER[:3]


class Wire:
    """The SDK's port that keeps what is written and gives what it is told."""

    is_using = False

    def __init__(self) -> None:
        self.written, self.coming = b"", b""

    def clearPort(self) -> None: ...

    def writePort(self, packet: list[int]) -> int:
        self.written += bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        found, self.coming = self.coming[:length], self.coming[length:]
        return found

    def isPacketTimeout(self) -> bool:
        return not self.coming


def by_sdk(frame: Frame) -> bytes:
    """The bytes that the maker's SDK makes of a frame; 4.1.0 forgets to stuff what it sends."""
    assert MARK not in frame.parameters
    wire, n = Wire(), len(frame.parameters) + 3
    packet = [0] * 4 + [frame.id, n & 0xFF, n >> 8, frame.instruction, *frame.parameters, 0, 0]
    assert SDK.txPacket(wire, packet) == COMM_SUCCESS
    return wire.written


def drawn(draw: random.Random) -> Frame:
    """A frame whose parameters often look like a header."""
    alphabet = (0xFF, 0xFF, 0xFD, 0x00, draw.randrange(256))
    parameters = bytes(draw.choice(alphabet) for _ in range(draw.randrange(40)))
    return Frame(draw.randrange(253), draw.randrange(1, 0x55), parameters)


def test_frames_are_those_of_the_makers_sdk() -> None:
    """Also by the example of the maker's page: a ping of the servo 1."""
    assert encode(Frame(1, 1, b"")) == bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E")
    draw = random.Random(1)
    for _ in range(500):
        frame = drawn(draw)
        if MARK not in frame.parameters:
            assert encode(frame) == by_sdk(frame)
        wire = Wire()
        wire.coming = status(frame.id, 0, frame.parameters)
        packet, result = SDK.rxPacket(wire, False)
        assert result == COMM_SUCCESS and packet[4] == frame.id
        # Behind a mark, 4.1.0 takes the second FD of FF FD FD for stuffing: the length tells.
        if packet[5] | packet[6] << 8 == len(frame.parameters) + 4:
            assert bytes(packet[9 : 9 + len(frame.parameters)]) == frame.parameters
        else:
            assert MARK in frame.parameters and b"\xff\xfd\xfd" in frame.parameters


def test_every_valid_frame_is_found_between_noise_and_nothing_breaks(full: bool) -> None:
    draw, parser, lost = random.Random(2), FrameParser(), 0
    for _ in range(1_000_000 if full else 10_000):
        frame = drawn(draw)
        noise = draw.randbytes(draw.randrange(8))
        if draw.random() < 0.2:
            noise += HEADER[: draw.randrange(1, 5)]
        elif draw.random() < 0.1:
            noise += HEADER + bytes([draw.randrange(253), draw.randrange(256), 0])  # swallows it
        data = bytearray(noise + encode(frame))
        broken = draw.random() < 0.2
        if broken:
            data[draw.randrange(len(noise) + 4, len(data))] ^= 1 << draw.randrange(8)
        cut = draw.randrange(len(data) + 1)
        found = parser.feed(bytes(data[:cut])) + parser.feed(bytes(data[cut:])) + parser.pause()
        lost += not broken and frame not in found
        assert not broken or frame not in found
    assert lost == 0


@pytest.fixture
def line() -> ServoLine:
    return ServoLine([Servo(1, position=1.0), Servo(2), Servo(7, lag=0.02)])


@pytest.fixture
def port(line: ServoLine) -> MemoryPort:
    return MemoryPort(line)


def test_ping_read_and_write(line: ServoLine, port: MemoryPort) -> None:
    assert SDK.ping(port, 1) == (1020, COMM_SUCCESS, 0)
    assert SDK.ping(port, 3)[1] == COMM_RX_TIMEOUT
    assert SDK.broadcastPing(port)[0] == {1: [1020, 46], 2: [1020, 46], 7: [1020, 46]}
    assert SDK.read4ByteTxRx(port, 1, 132) == (round(1.0 / servo_motor.RAD), COMM_SUCCESS, 0)
    assert SDK.write1ByteTxRx(port, 1, 11, 5) == (COMM_SUCCESS, 0)
    assert SDK.read1ByteTxRx(port, 1, 11)[0] == 5
    assert SDK.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    assert SDK.write1ByteTxRx(port, 1, 11, 3)[1] == 7, "torque locks the EEPROM: access error"
    assert SDK.write2ByteTxRx(port, 1, 102, 1194)[1] == 6, "above the limit of the current"
    assert SDK.write2ByteTxRx(port, 1, 144, 0)[1] == 7, "read-only"
    assert SDK.readTxRx(port, 1, 140, 100)[2] == 5
    assert SDK.factoryReset(port, 2, 0xFF)[1] == 2, "not emulated: an instruction error"


def test_the_status_return_level_is_kept(port: MemoryPort) -> None:
    assert SDK.write1ByteTxRx(port, 2, 68, 0)[0] == COMM_SUCCESS
    assert SDK.write1ByteTxRx(port, 2, 98, 5)[0] == COMM_RX_TIMEOUT
    assert SDK.read1ByteTxRx(port, 2, 11)[1] == COMM_RX_TIMEOUT
    assert SDK.ping(port, 2)[1] == COMM_SUCCESS


def test_groups_are_written_and_read(port: MemoryPort) -> None:
    written, read = GroupSyncWrite(port, SDK, 116, 4), GroupSyncRead(port, SDK, 116, 4)
    assert all(written.addParam(i, list((i * 100).to_bytes(4, "little"))) for i in (1, 2, 7))
    assert written.txPacket() == COMM_SUCCESS
    assert all(read.addParam(i) for i in (1, 2, 7))
    assert read.txRxPacket() == COMM_SUCCESS
    assert [read.getData(i, 116, 4) for i in (1, 2, 7)] == [100, 200, 700]


@pytest.mark.parametrize("lag", [0.02, 0.06])
def test_a_motor_follows_behind_its_lag_to_its_stop(lag: float) -> None:
    servo = Servo(1, lag=lag, stops=(-9.0, 1.0))
    port = MemoryPort(ServoLine([servo]))
    assert SDK.write1ByteTxRx(port, 1, 64, 1)[1] == 0
    assert SDK.write4ByteTxRx(port, 1, 116, round(0.5 / servo_motor.RAD))[1] == 0
    reached = 0.5 / servo_motor.FASTEST
    port.wait(port.time + reached + lag)
    off = 0.5 - servo.position
    assert 0.0 < off < 0.5 * lag / reached * 0.5, "an e-th of the lag behind the profile's end"
    port.wait(port.time + 8 * lag)
    assert servo.position == pytest.approx(0.5, abs=0.001)
    SDK.write2ByteTxRx(port, 1, 102, 100)
    SDK.write4ByteTxRx(port, 1, 116, round(3.0 / servo_motor.RAD))
    port.wait(port.time + 1.0)
    assert servo.position == 1.0
    assert SDK.read2ByteTxRx(port, 1, 126)[0] == 100, "its bound, at the stop"


def test_the_watchdog_holds_a_motor_that_nobody_speaks_to() -> None:
    servo = Servo(1)
    port = MemoryPort(ServoLine([servo]))
    SDK.write1ByteTxRx(port, 1, 64, 1)
    SDK.write1ByteTxRx(port, 1, 98, 5)
    SDK.write4ByteTxRx(port, 1, 116, 100_000)
    port.wait(port.time + 0.5)
    before = servo.position
    assert 0.3 < before < 1.0
    port.wait(port.time + 0.5)
    assert servo.position == pytest.approx(before, abs=0.001)
    assert SDK.read1ByteTxRx(port, 1, 98)[0] == 0xFF
    assert SDK.write4ByteTxRx(port, 1, 116, 0)[1] == 4, "goals are read-only then"


def test_a_hardware_error_is_told_until_the_servo_is_restarted(line: ServoLine) -> None:
    port = MemoryPort(line)
    assert line.schedule.answer("overload 2", port.time) == "ok"
    assert SDK.read1ByteTxRx(port, 2, 70) == (0x20, COMM_SUCCESS, ALERT)
    SDK.write1ByteTxRx(port, 2, 64, 1)
    assert SDK.read1ByteTxRx(port, 2, 64)[0] == 0
    assert SDK.reboot(port, 2)[0] == COMM_SUCCESS
    assert SDK.ping(port, 2)[1] == COMM_RX_TIMEOUT
    port.wait(port.time + 0.5)
    assert SDK.read1ByteTxRx(port, 2, 70) == (0, COMM_SUCCESS, 0)


def test_another_baud_is_not_heard_and_two_servos_with_one_id_collide() -> None:
    port = MemoryPort(ServoLine([Servo(1, baud=57_600), Servo(2, position=1.0), Servo(2)]))
    assert SDK.ping(port, 1)[1] == COMM_RX_TIMEOUT
    assert SDK.ping(port, 2)[1] == COMM_SUCCESS, "equal answers look like one"
    assert SDK.read4ByteTxRx(port, 2, 132)[1] != COMM_SUCCESS
    port.setBaudRate(57_600)
    assert SDK.ping(port, 1)[1] == COMM_SUCCESS


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("loss 2", "share '2': must be a number from 0 to 1"),
        ("stall 9 on", "id '9': must be one of 1, 2, 7"),
        ("stall 1", "stall takes: ID on|off"),
        ("earthquake", "'earthquake' is not known"),
    ],
)
def test_a_fault_that_is_none_is_refused(fault: str, said: str, line: ServoLine) -> None:
    assert said in line.schedule.answer(fault, 0.0)


def test_the_sdk_speaks_over_the_pseudo_terminal_until_it_is_unplugged(tmp_path: Path) -> None:
    with_terminals()
    path = tmp_path / "servos"
    emulator = DriveEmulator(path, [Servo(1, position=1.0), Servo(2)])
    try:
        port = SerialPort(path, 1_000_000, patience=60.0)
        assert SDK.ping(port, 2) == (1020, COMM_SUCCESS, 0)
        assert SDK.write1ByteTxRx(port, 2, 64, 1) == (COMM_SUCCESS, 0)
        group = GroupSyncRead(port, SDK, 132, 4)
        assert group.addParam(1) and group.addParam(2)
        for _ in range(20):
            assert group.txRxPacket() == COMM_SUCCESS
            assert group.getData(1, 132, 4) == round(1.0 / servo_motor.RAD)
        with pytest.raises(OSError, match="lock"):
            SerialPort(path, 1_000_000)
        assert emulator.fault("loss 1") == "ok"
        assert "stall ID on|off" in emulator.fault("help")
        emulator.unplug()
        with pytest.raises(OSError):
            SDK.ping(port, 1)
        assert not path.exists()
        emulator.plug()
        emulator.fault("loss 0")
        again = SerialPort(path, 1_000_000, patience=60.0)
        assert SDK.ping(again, 1)[1] == COMM_SUCCESS
    finally:
        emulator.close()
