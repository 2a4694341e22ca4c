"""The emulated controller behind real sockets, driven cycle by cycle without a clock."""

import contextlib
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur
from helpers.hardware.emulated_ur import Client, free_address, made, packets
from surg_emulators.ur import ur_emulator
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import UrController
from surg_emulators.ur.ur_emulator import DOWN, FIRST_RTDE, PORTS, RESTART, UrEmulator


@pytest.fixture
def emulator() -> Iterator[UrEmulator]:
    made_here = UrEmulator(UrController(), free_address())
    yield made_here
    made_here.close()


class Peer:
    """A client's socket; the emulator works whenever the client waits."""

    def __init__(self, emulator: UrEmulator, service: str) -> None:
        self.emulator = emulator
        self.socket = socket.create_connection((emulator.address, emulator.ports[service]), 2.0)
        self.socket.setblocking(False)
        self.work(3)

    def work(self, rounds: int = 1) -> None:
        for _ in range(rounds):
            self.emulator.poll(0.01)

    def send(self, data: bytes) -> bytes:
        """Send, and take what comes back at once."""
        self.socket.sendall(data)
        self.work(2)
        return self.take()

    def take(self) -> bytes:
        """What has arrived."""
        data = b""
        with contextlib.suppress(BlockingIOError):
            while more := self.socket.recv(1 << 16):
                data += more
        return data

    @property
    def gone(self) -> bool:
        """Whether the connection has ended."""
        try:
            while self.socket.recv(1 << 16):
                pass
        except BlockingIOError:
            return False
        except ConnectionResetError:
            pass
        return True


def subscribed(emulator: UrEmulator) -> Peer:
    """A client that gets states."""
    peer = Peer(emulator, "rtde")
    names = struct.pack(">d", 500.0) + b"timestamp"
    setup = made("V", b"\x00\x02") + made("O", names) + made("S")
    assert [kind for kind, _ in packets(peer.send(setup))] == ["V", "O", "S"]
    return peer


def stamps(data: bytes) -> list[float]:
    return [struct.unpack(">d", body[1:])[0] for kind, body in packets(data) if kind == "U"]


def cycles(emulator: UrEmulator, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        emulator.cycle()
        emulator.poll(0.0)


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.56.2", "8.8.8.8"])
def test_only_loopback_is_served(address: str) -> None:
    with pytest.raises(ValueError, match="loopback"):
        UrEmulator(UrController(), address)


def test_a_taken_port_is_named(emulator: UrEmulator) -> None:
    with pytest.raises(OSError, match=f"{emulator.address}:29999"):
        UrEmulator(UrController(), emulator.address)


def test_free_ports_can_be_asked_for() -> None:
    emulator = UrEmulator(UrController(), free_address(), dict.fromkeys(PORTS, 0))
    assert len(set(emulator.ports.values())) == len(PORTS)
    assert 0 not in emulator.ports.values()
    emulator.close()


def test_every_service_greets_as_an_arm_does(emulator: UrEmulator) -> None:
    assert Peer(emulator, "dashboard").take().startswith(b"Connected: Universal Robots")
    for service in ("primary", "secondary"):
        assert Peer(emulator, service).take()[4] == 20
    assert Peer(emulator, "rtde").take() == b""


def test_one_state_per_cycle(emulator: UrEmulator) -> None:
    peer = subscribed(emulator)
    cycles(emulator, 0.02)
    assert stamps(peer.take()) == pytest.approx([DT * n for n in range(1, 11)])


def test_a_stall_delays_everything_and_then_delivers_it(emulator: UrEmulator) -> None:
    peer = subscribed(emulator)
    assert emulator.fault("stall 0.1") == "ok"
    cycles(emulator, 0.09)
    assert peer.take() == b""
    peer.socket.sendall(made("v"))
    cycles(emulator, 0.02)
    peer.work(2)
    data = peer.take()
    assert len(stamps(data)) == 55
    assert [kind for kind, _ in packets(data)].count("v") == 1


def test_a_reset_ends_all_connections(emulator: UrEmulator) -> None:
    peers = [Peer(emulator, service) for service in ("dashboard", "secondary", "rtde")]
    for peer in peers:
        peer.take()
    emulator.fault("reset")
    assert all(peer.gone for peer in peers)
    subscribed(emulator)


def test_after_a_reboot_rtde_starts_twice(emulator: UrEmulator) -> None:
    first = subscribed(emulator)
    emulator.fault("reboot")
    assert first.gone
    for service in ("rtde", "dashboard", "secondary"):
        with pytest.raises(OSError):
            Peer(emulator, service)
    cycles(emulator, DOWN + 0.01)
    second = subscribed(emulator)
    cycles(emulator, 0.1)
    assert stamps(second.take())[0] < DOWN + 0.1  # the clock began again
    cycles(emulator, FIRST_RTDE - 0.1)
    assert second.gone
    Peer(emulator, "dashboard")
    with pytest.raises(OSError):
        Peer(emulator, "rtde")
    cycles(emulator, RESTART + 0.01)
    third = subscribed(emulator)
    cycles(emulator, 1.0)
    assert len(stamps(third.take())) == 500


def test_malformed_packets_are_sent_on_request(emulator: UrEmulator) -> None:
    peer = subscribed(emulator)
    emulator.fault("size0")
    assert peer.take() == b"\x00\x00\x00"
    emulator.fault("garbage")
    assert peer.take()[2:4] == b"U\x07"
    cycles(emulator, DT)
    whole = len(peer.take())
    emulator.fault("half")
    with contextlib.suppress(ConnectionResetError):
        assert len(peer.take()) == whole // 2
    assert peer.gone


def test_faked_states_reach_clients(emulator: UrEmulator) -> None:
    client = Client(RtdeSession(emulator.controller))
    client.set_up(["actual_q", "robot_mode", "timestamp"])
    for line in ("nan on", "mode 99", "clock_back 5"):
        assert emulator.fault(line) == "ok"
    state = emulated_ur.cycle(emulator.controller, client)
    assert state["robot_mode"] == 99
    assert state["timestamp"] == pytest.approx(DT - 5.0)
    assert all(q != q for q in state["actual_q"])
    for line in ("nan off", "mode off", "clock_back 0"):
        emulator.fault(line)
    assert emulated_ur.cycle(emulator.controller, client)["robot_mode"] == 7


def test_registers_of_a_second_client_are_in_use(emulator: UrEmulator) -> None:
    emulator.fault("second_client input_int_register_24")
    client = Client(RtdeSession(emulator.controller))
    assert client.ask("I", b"input_int_register_24") == [("I", b"\x00IN_USE")]
    emulator.fault("second_client")
    assert client.ask("I", b"input_int_register_24") == [("I", b"\x01INT32")]


def test_a_slow_client_loses_whole_states_only(emulator: UrEmulator) -> None:
    peer = subscribed(emulator)
    for _ in range(400_000):
        emulator.send_raw(b"\x00\x04U\x01" * 16)
        if len(emulator._connections[0].waiting) > 60_000:
            break
    assert len(emulator._connections[0].waiting) <= 1 << 16
    kinds = {kind for kind, _ in packets(peer.take()[: 1 << 15])}
    assert kinds == {"U"}


def test_the_control_port_takes_faults(emulator: UrEmulator) -> None:
    peer = Peer(emulator, "control")
    assert peer.send(b"slider 50\n") == b"ok\n"
    assert emulator.controller.slider == 0.5
    assert peer.send(b"slider 500\nat 0.01 slider 100\n").startswith(b"error: slider '500'")
    cycles(emulator, 0.02)
    assert emulator.controller.slider == 1.0
    assert b'"robot_mode": "RUNNING"' in peer.send(b"status\n")
    assert b"protective_stop" in peer.send(b"help\n")


@pytest.mark.parametrize("share", [-0.05, 0.0, 0.046])
def test_the_robots_clock_may_run_fast_or_slow(
    share: float, emulator: UrEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(emulator, "poll", lambda left=0.0: now.__setitem__(0, now[0] + left))
    assert emulator.fault(f"drift {share}") == "ok"
    emulator.run(10.0)
    assert emulator.controller.timestamp == pytest.approx(10.0)
    assert now[0] - 100.0 == pytest.approx(10.0 / (1.0 + share), abs=DT)


def test_a_late_emulator_leaves_cycles_out_rather_than_hurrying(
    emulator: UrEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, waits = [100.0], []

    def poll(left: float = 0.0) -> None:
        waits.append(left)
        now[0] += 1.0 if len(waits) == 100 else left

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(emulator, "poll", poll)
    emulator.run(1.0)
    assert sum(left <= 0.0 for left in waits) == 1
    assert now[0] - 100.0 == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--address", "10.0.0.1"], "loopback"),
        (["--address", "nowhere"], "nowhere"),
        (["--ports", "rtde=70000"], "rtde=70000"),
        (["--ports", "telnet=23"], "telnet=23"),
        (["--faults", "/nonexistent"], "/nonexistent"),
    ],
)
def test_wrong_options_end_with_2_and_are_named(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    address = [] if "--address" in words else ["--address", free_address()]
    assert ur_emulator.main([*words, *address]) == 2
    assert said in capsys.readouterr().err


def test_a_wrong_line_of_the_fault_file_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "faults.txt"
    file.write_text("at 1 estop\nat 2 explode\n")
    assert ur_emulator.main(["--address", free_address(), "--faults", str(file)]) == 2
    assert "line 2: 'explode'" in capsys.readouterr().err


def test_the_program_runs_its_fault_file(tmp_path: Path) -> None:
    file = tmp_path / "faults.txt"
    file.write_text("at 0.2 protective_stop\n")
    log = tmp_path / "emulator.log"
    with emulated_ur.program(log, "--faults", str(file), "--model", "UR10e") as address:
        for _ in range(100):
            if "PROTECTIVE_STOP" in emulated_ur.fault(address, "status"):
                break
            time.sleep(0.02)
        else:
            raise AssertionError(log.read_text())
    assert "Emulated UR10e on" in log.read_text()
