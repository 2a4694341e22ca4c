"""The emulated Franka controller behind real sockets, driven cycle by cycle without a clock."""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.hardware import emulated_franka, emulated_ur
from helpers.hardware.emulated_franka import MOVE_SIZE, State
from helpers.hardware.emulated_ur import free_address
from surg_emulators.franka import franka_emulator
from surg_emulators.franka.fci_messages import HEADER
from surg_emulators.franka.franka_controller import FrankaController, RobotMode
from surg_emulators.franka.franka_emulator import DOWN, FrankaEmulator
from surg_emulators.franka.franka_robots import FER, ROBOTS, FrankaRobot
from surg_emulators.franka.generator_motion import DT

BOTH = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
LOST = ["communication_constraints_violation"]


@pytest.fixture
def emulator(robot: FrankaRobot) -> Iterator[FrankaEmulator]:
    made_here = FrankaEmulator(FrankaController(robot), free_address())
    yield made_here
    made_here.close()


class Peer:
    """A client with sockets; the emulator works whenever the client waits."""

    def __init__(self, emulator: FrankaEmulator) -> None:
        self.emulator, self.protocol = emulator, emulator.controller.protocol
        self.tcp = socket.create_connection((emulator.address, emulator.ports["command"]), 2.0)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("", 0))
        self.udp.setblocking(False)
        self.tcp.setblocking(False)
        emulator.poll(0.1)
        self.states: list[State] = []
        self._back = ("", 0)

    def connect(self) -> None:
        port = self.udp.getsockname()[1]
        assert self.ask(0, struct.pack("<HH", self.protocol.version, port))[12] == 0

    def ask(self, command: int, body: bytes = b"") -> bytes:
        """Send a request; what comes back at once."""
        self.tcp.sendall(HEADER.pack(command, 9, HEADER.size + len(body)) + body)
        self.emulator.poll(0.1)
        return self.answers()

    def answers(self) -> bytes:
        try:
            return self.tcp.recv(1 << 16)
        except BlockingIOError:
            return b""

    def move(self) -> None:
        """A joint velocity motion whose first command has come."""
        body = struct.pack("<II", 0, 1).ljust(MOVE_SIZE[self.protocol.version], b"\0")
        assert self.ask(1, body)[12] == 1
        self.cycles(2)
        assert self.emulator.controller.active is not None
        assert self.emulator.controller.active.started

    def cycles(self, count: int = 1) -> None:
        """The emulator's cycles; each newest state is answered with rest."""
        for _ in range(count):
            self.emulator.cycle()
            self.take()
            if self.states:
                self.answer()
            self.emulator.poll()

    def answer(self) -> None:
        """Send a command that answers the newest state: rest."""
        number = struct.pack("<Q", self.states[-1].number)
        self.udp.sendto(number.ljust(self.protocol.command.size, b"\0"), self._back)

    def take(self) -> None:
        """Read all states that wait."""
        while True:
            try:
                data, self._back = self.udp.recvfrom(1 << 16)
            except BlockingIOError:
                return
            if len(data) == self.protocol.state.size:
                self.states.append(State.of(self.protocol, data))

    def close(self) -> None:
        self.tcp.close()
        self.udp.close()


def fault(emulator: FrankaEmulator, line: str) -> str:
    answer = emulator.fault(line)
    assert not answer.startswith("error"), answer
    return answer


def connected(emulator: FrankaEmulator) -> Peer:
    peer = Peer(emulator)
    peer.connect()
    peer.cycles(2)
    return peer


@BOTH
def test_one_state_per_cycle_with_growing_numbers(emulator: FrankaEmulator) -> None:
    peer = connected(emulator)
    peer.cycles(50)
    numbers = [state.number for state in peer.states]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(numbers) == 52
    peer.close()


@BOTH
def test_a_second_client_is_turned_away(emulator: FrankaEmulator) -> None:
    peer, second = connected(emulator), Peer(emulator)
    assert second.tcp.recv(100) == b""
    peer.cycles(1)
    assert peer.states
    peer.close()
    emulator.poll(0.1)
    connected(emulator).close()


@BOTH
@pytest.mark.parametrize(
    ("line", "lost", "reflex"),
    [
        ("burst 20 commands", 20, False),
        ("burst 21 commands", 21, True),
        ("burst 20 states", 20, False),
        ("stall 0.015", 14, False),
        ("stall 0.1", 21, True),
        ("duplicate 1", 0, False),
        ("loss 1 states", 21, True),
    ],
)
def test_faults_of_the_network(
    line: str, lost: int, reflex: bool, emulator: FrankaEmulator
) -> None:
    peer = connected(emulator)
    peer.move()
    controller = emulator.controller
    fault(emulator, line)
    most = 0
    for _ in range(150):
        peer.cycles()
        if controller.active is None:
            break
        most = max(most, controller.active.lost)
    assert (controller.mode is RobotMode.REFLEX) == reflex
    assert [error.name for error in controller.errors] == (LOST if reflex else [])
    if not reflex:
        assert abs(most - lost) <= 1
    peer.close()


@BOTH
def test_a_stall_delivers_everything_afterwards_and_late_commands_count_for_nothing(
    emulator: FrankaEmulator,
) -> None:
    peer = connected(emulator)
    peer.move()
    fault(emulator, "stall 0.01")
    peer.answer()
    peer.states.clear()
    peer.cycles(30)
    numbers = [state.number for state in peer.states]
    assert numbers == list(range(numbers[0], numbers[0] + 30))
    assert emulator.controller.mode is RobotMode.MOVE
    assert emulator.controller.sent_late == 1
    peer.close()


@BOTH
def test_reordered_commands_are_lost_but_bearable(emulator: FrankaEmulator) -> None:
    peer = connected(emulator)
    peer.move()
    fault(emulator, "reorder 0.2 commands")
    peer.cycles(500)
    assert emulator.controller.mode is RobotMode.MOVE
    assert 0.5 < emulator.controller.success_rate < 0.95
    assert emulator.controller.sent_late > 20
    peer.close()


@BOTH
def test_a_reboot_closes_the_ports_and_then_the_brakes_are_closed(
    emulator: FrankaEmulator,
) -> None:
    peer = connected(emulator)
    peer.move()
    fault(emulator, "reboot")
    with pytest.raises(OSError):
        Peer(emulator)
    with pytest.raises(ConnectionResetError):
        peer.tcp.recv(100)
    for _ in range(round(DOWN / DT) + 1):
        emulator.cycle()
    again = connected(emulator)
    assert again.states[-1].mode == RobotMode.OTHER
    assert again.states[-1].number < peer.states[-1].number + DOWN / DT  # counted anew
    fault(emulator, "brakes release")
    again.cycles(1001)
    assert again.states[-1].mode == RobotMode.IDLE
    again.close()


@BOTH
def test_a_reset_and_a_killed_client_end_the_motion(emulator: FrankaEmulator) -> None:
    for line in ("reset", ""):
        peer = connected(emulator)
        peer.move()
        if line:
            fault(emulator, line)
        else:
            peer.close()
            emulator.poll(0.1)
        assert [error.name for error in emulator.controller.errors] == LOST
        emulator.controller.recover()
        for _ in range(300):
            emulator.cycle()
        assert emulator.controller.mode is RobotMode.IDLE


@BOTH
def test_people_by_the_control_port(emulator: FrankaEmulator) -> None:
    peer = connected(emulator)
    modes = []
    for line in (
        "user_stop on", "user_stop off", "guide on 0.1 0 0 0 0 0 0", "guide off", "collision 3",
    ):  # fmt: skip
        fault(emulator, line)
        peer.cycles(2)
        modes.append(peer.states[-1].mode)
    assert modes == [5, 1, 3, 1, 4]
    found = json.loads(fault(emulator, "status"))
    assert (found["mode"], found["errors"]) == ("REFLEX", ["joint_reflex"])
    peer.close()


@BOTH
def test_states_can_be_wrong_on_request(emulator: FrankaEmulator) -> None:
    peer = connected(emulator)
    for line in ("nan on", "mode 99", "clock_back 1000", "load 0.8 0 0.02 0.11"):
        fault(emulator, line)
    peer.cycles(1)
    state = peer.states[-1]
    assert all(math.isnan(q) for q in state.values["q"])
    assert (state.mode, state.number) == (99, 0)
    assert state.values["m_load"] == pytest.approx((0.8,))
    for line in ("nan off", "mode off", "clock_back 0"):
        fault(emulator, line)
    peer.cycles(1)
    state = peer.states[-1]
    assert (state.mode, state.number) == (RobotMode.IDLE, emulator.controller.number)
    assert all(math.isfinite(q) for q in state.values["q"])
    peer.close()


@BOTH
@pytest.mark.parametrize(
    "line",
    ["loss 2", "loss", "reorder 0.1 sideways", "collision 8", "reflex flu", "push 1 2", "explode"],
)
def test_wrong_faults_are_answered_with_an_error(line: str, emulator: FrankaEmulator) -> None:
    assert emulator.fault(line).startswith("error: ")


@BOTH
def test_a_late_emulator_leaves_its_client_time(
    emulator: FrankaEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a cycle that came 50 ms late, every client still has 0.8 ms, and time is caught up."""
    now, waits = [100.0], []

    def poll(left: float = 0.0) -> None:
        waits.append(left)
        now[0] += 0.05 if len(waits) == 100 else left

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(emulator, "poll", poll)
    emulator.run(1.0)
    assert min(waits) == pytest.approx(0.8 * DT)
    assert now[0] - 100.0 == pytest.approx(1.0, abs=2 * DT)


@BOTH
def test_a_command_that_came_while_the_emulator_was_late_counts(emulator: FrankaEmulator) -> None:
    peer = connected(emulator)
    peer.move()
    for _ in range(30):  # nobody polls: the program was not scheduled
        emulator.cycle()
        peer.take()
        peer.answer()
    emulator.cycle()
    assert emulator.controller.active is not None
    assert emulator.controller.active.lost == 0
    peer.close()


def test_a_wrong_option_ends_with_2_and_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert franka_emulator.main(["fer", "--q", "0", "0", "--address", free_address()]) == 2
    assert "7" in capsys.readouterr().err


def test_the_program_runs_its_fault_file_and_writes_its_record(tmp_path: Path) -> None:
    file, record = tmp_path / "faults.txt", tmp_path / "record.csv"
    file.write_text("at 0.2 user_stop\n")
    log = tmp_path / "emulator.log"
    options = ("--faults", str(file), "--record", str(record))
    with emulated_franka.program("fr3", log, *options) as address:
        for _ in range(100):
            if "USER_STOPPED" in emulated_ur.fault(address, "status"):
                break
            time.sleep(0.02)
        else:
            raise AssertionError(log.read_text())
    assert "Emulated Franka Research 3" in log.read_text()
    head, *rows = record.read_text().splitlines()
    assert len(rows) > 100 and len(rows[0].split(",")) == len(head.split(",")) == 4 + 35


def test_the_flange_is_where_franka_says() -> None:
    """The documented pose of the flange at the documented ready posture of a Panda."""
    emulator = FrankaEmulator(FrankaController(FER), free_address())
    try:
        peer = connected(emulator)
        pose = peer.states[-1].values["O_T_EE"]
        assert pose[12:15] == pytest.approx((0.30689, 0.0, 0.59028), abs=1e-5)
        peer.close()
    finally:
        emulator.close()
