"""The robot API of PolyScope X: power, stops and what a person is told, as with a dashboard.

The emulated controller answers as the maker's public client library expects.
"""

from __future__ import annotations

import http.client
import io
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur
from helpers.hardware.emulated_cell import HOME, SERIAL, emulated_cell
from helpers.hardware.ur_driver_rig import DriverThread
from surg_cli.host.terminal import CliError
from surg_cli.robots import robot_doctor
from surg_emulators.ur import ur_controller
from surg_emulators.ur.robot_api_server import ROOT, RobotApiSession
from surg_emulators.ur.robot_states import RobotMode, SafetyMode
from surg_emulators.ur.ur_controller import UrController
from surg_emulators.ur.ur_emulator import UrEmulator
from surg_hardware.conditions import Condition
from surg_hardware.ur import orders, robot_api
from surg_hardware.ur.orders import Order
from surg_hardware.ur.robot_api import RobotApi


@pytest.fixture
def emulator(monkeypatch: pytest.MonkeyPatch) -> Iterator[UrEmulator]:
    """An arm with PolyScope X that is off, with short times and a robot API at a free port."""
    monkeypatch.setattr(ur_controller, "POWER_TIME", 0.02)
    controller = UrController(serial=SERIAL, q=HOME, ready=False, polyscope="x")
    with emulated_ur.in_process(controller, {"api": 0}) as made:
        assert "dashboard" not in made.ports
        monkeypatch.setattr(robot_api, "PORT", made.ports["api"])
        yield made


@pytest.fixture
def robot(
    emulator: UrEmulator,
    surg: Callable[..., int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[str], int]:
    """Runs `./surg robot CELL ACTION`; a person says yes."""
    cell = emulated_cell(tmp_path, emulator.address)

    def run(action: str) -> int:
        monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
        return surg("robot", str(cell), action)

    return run


def test_the_version_chooses_the_robot_api(emulator: UrEmulator) -> None:
    found = orders.of(emulator.address)
    assert isinstance(found, RobotApi)
    assert found.identity() == (SERIAL, "UR5e")
    assert found.version() == "10.14.0" and found.remote() and not found.running()


def test_the_first_power_on_with_every_stop_on_the_way(
    robot: Callable[[str], int], emulator: UrEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    c = emulator.controller
    monkeypatch.setattr(robot_doctor, "MEASURED_S", 0.1)
    assert robot("on") == 0 and c.robot_mode == RobotMode.RUNNING
    assert robot("kinematics") == 0
    c.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test")
    with pytest.raises(CliError, match="button"):
        robot("recover")
    c.release()
    assert robot("on") == 0
    c.protective_stop("test")
    with pytest.raises(CliError, match="wait 5 s"):
        robot("recover")
    monkeypatch.setattr(ur_controller, "UNLOCK_AFTER", 0.0)
    assert robot("recover") == 0 and c.safety_mode == SafetyMode.NORMAL
    c.fall_to(SafetyMode.VIOLATION, "test")
    assert robot("recover") == 0 and c.safety_mode == SafetyMode.NORMAL
    c.remote = False
    with pytest.raises(CliError, match="local control"):
        robot("on")
    c.remote = True
    assert robot("on") == 0
    assert robot("off") == 0 and c.robot_mode == RobotMode.POWER_OFF
    assert c.motion.actual_q == list(HOME), "nothing has moved"


def test_the_doctor_reads_the_same_lines(emulator: UrEmulator, tmp_path: Path) -> None:
    emulator.controller.robot_mode = RobotMode.RUNNING
    emulator.controller.remote = False
    cell = str(emulated_cell(tmp_path, emulator.address))
    lines = {line.what: line for line in robot_doctor.findings(cell, None, 0.1)}
    assert lines["PSM1: version"].text == "10.14.0"
    assert lines["PSM1: control"].good is False


def test_the_driver_starts_stops_and_is_refused_through_the_robot_api(
    emulator: UrEmulator,
) -> None:
    emulator.controller.robot_mode = RobotMode.RUNNING
    driver = DriverThread(emulator.address)
    driver.until(lambda condition: condition is Condition.READY)
    driver.until(lambda condition: condition is Condition.GUIDED, "guide")
    driver.until(lambda condition: condition is Condition.READY, "stop")
    assert emulator.controller.program is None
    emulator.controller.remote = False
    driver.until(lambda _: any("local control" in text for text in driver.notices), "start")
    driver.end()


@pytest.mark.parametrize("order", Order)
def test_every_order_of_local_control_is_forbidden(order: Order, emulator: UrEmulator) -> None:
    emulator.controller.remote = False
    assert RobotApi(emulator.address).order(order) == orders.LOCAL


def test_an_order_in_the_wrong_state_says_so_and_nobody_is_named(emulator: UrEmulator) -> None:
    assert "Conflict" in RobotApi(emulator.address).order(Order.RESTART_SAFETY)
    with pytest.raises(OSError):
        RobotApi(emulated_ur.free_address()).robot_mode()


@pytest.mark.parametrize(
    ("request_line", "body", "status"),
    [
        ("GET /other", None, 404),
        ("POST /robotstate/v1/state", {"action": "POWER_ON"}, 405),
        ("PUT /robotstate/v1/state", {"action": "DANCE"}, 422),
        ("PUT /robotstate/v1/state", {"deed": 1}, 422),
        ("PUT /program/v1/state", {"action": "play"}, 409),
        ("GET /openapi.json", None, 200),
    ],
)
def test_requests_are_answered_by_their_status(
    request_line: str, body: dict[str, object] | None, status: int
) -> None:
    method, _, path = request_line.partition(" ")
    text = json.dumps(body).encode() if body else b""
    session = RobotApiSession(UrController(polyscope="x"))
    head = f"{method} {ROOT}{path} HTTP/1.1\r\nContent-Length: {len(text)}\r\n\r\n".encode()
    answer = b"".join(session.receive(bytes([each])) for each in head + text)
    assert answer.startswith(f"HTTP/1.1 {status} ".encode()) and not session.closed


@pytest.mark.parametrize(
    "answer", [b"SSH-2.0\n", b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n[]", b""]
)
def test_what_is_no_robot_api_is_named(answer: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = socket.socketpair()
    monkeypatch.setattr(
        http.client.HTTPConnection, "connect", lambda self: setattr(self, "sock", ours)
    )
    theirs.sendall(answer)
    theirs.shutdown(socket.SHUT_WR)
    with theirs, pytest.raises(OSError):
        RobotApi("127.0.0.1").robot_mode()
