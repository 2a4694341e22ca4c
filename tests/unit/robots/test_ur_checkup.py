"""`./surg robot CELL doctor` names what is wrong with an arm, with the cure; nothing moves."""

from __future__ import annotations

import dataclasses
import datetime
import ipaddress
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.hardware import emulated_ur
from helpers.hardware.emulated_cell import BUNDLED, HOME, SERIAL, emulated_cell
from surg_cli.graph.roles import Route
from surg_cli.robots import robot_doctor
from surg_emulators.ur import ur_controller
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.robot_states import SafetyMode
from surg_emulators.ur.ur_controller import UrController
from surg_emulators.ur.ur_emulator import UrEmulator
from surg_hardware import checkup
from surg_hardware.checkup import Finding
from surg_hardware.ur import dashboard, ur_checkup

Wrong = Callable[[UrEmulator], object]


def fault(line: str) -> Wrong:
    def happen(emulator: UrEmulator) -> None:
        assert emulator.fault(line) == "ok"

    return happen


def program(emulator: UrEmulator) -> None:
    assert emulator.controller.run_script("def other():\n  while True:\n    sync()\n  end\nend\n")


WRONG: dict[str, tuple[Wrong, str, str]] = {
    "serial 77": (fault("serial 77"), "hardware.serial", "check address and serial"),
    "payload": (fault("payload 0.85"), "hardware.payload.mass", "set it on the pendant"),
    "centre": (fault("payload 0 0 0 0.1"), "hardware.payload.cog", "set it on the pendant"),
    "slider": (fault("slider 50"), "condition", "set it to 100 %"),
    "protective stop": (fault("protective_stop"), "condition", "recover"),
    "limiter": (fault("limiter 40"), "condition", "look for the cause on the pendant"),
    "safeguard": (fault("safeguard on"), "condition", "close the safeguard"),
    "e-stop": (fault("estop"), "condition", "release it"),
    "power": (fault("power off"), "condition", " on"),
    "brakes": (fault("brakes engage"), "condition", " on"),
    "hand": (fault("freedrive on"), "condition", "start"),
    "mode 99": (fault("mode 99"), "condition", "see the pendant"),
    "local": (fault("local"), "control", "switch it to remote control"),
    "program": (program, "program", "stop it"),
    "second client": (fault("second_client input_int_register_24"), "RTDE", "end it"),
    "joints": (fault("nan on"), "joints", "restart the robot"),
}
"""What is wrong -> the line that names it, and words of its cure."""


def bad(lines: list[Finding]) -> list[Finding]:
    """Bad lines; on a busy machine the clock of an emulator in a thread is not steady for 80 ms."""
    return [line for line in lines if line.good is False and line.what != "PSM1: clock"]


def examined(
    folder: Path, wrong: Wrong, controller: UrController | None = None, seconds: float = 0.08
) -> list[Finding]:
    """The check-up of an emulated arm with something wrong; nothing has moved."""
    with emulated_ur.in_process(controller or UrController(serial=SERIAL, q=HOME)) as emulator:
        wrong(emulator)
        before = list(emulator.controller.motion.actual_q)
        lines = robot_doctor.findings(str(emulated_cell(folder, emulator.address)), None, seconds)
        assert emulator.controller.motion.actual_q == before
    return lines


def test_nothing_is_wrong_with_the_cells_own_arm(tmp_path: Path) -> None:
    lines = examined(tmp_path, lambda emulator: None)
    assert bad(lines) == []
    assert {"PSM1: round trip", "PSM1: states", "PSM1: clock", "PSM1: forward kinematics"} <= {
        line.what for line in lines
    }


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_with_its_cure(what: str, tmp_path: Path) -> None:
    wrong, line, cure = WRONG[what]
    (found,) = bad(examined(tmp_path, wrong))
    assert found.what == f"PSM1: {line}"
    assert found.text and cure in found.cure


@pytest.mark.parametrize(
    ("controller", "line", "cure"),
    [
        (UrController(model="UR10e", serial=SERIAL, q=HOME), "robot", "name the YAML"),
        (
            UrController(serial=SERIAL, q=HOME, dh_errors=[(0.001, 0.0, 0.0)] * 6),
            "forward kinematics",
            "./surg robot",
        ),
    ],
)
def test_another_arm_is_named(
    controller: UrController, line: str, cure: str, tmp_path: Path
) -> None:
    found = {each.what: each for each in bad(examined(tmp_path, lambda emulator: None, controller))}
    assert cure in found[f"PSM1: {line}"].cure


@pytest.mark.parametrize(
    ("version", "needed"), [((5, 4, 0, 1), "PolyScope 5.6"), ((10, 7, 0, 1), "PolyScope X 10.14")]
)
def test_an_old_controller_is_named(
    version: tuple[int, ...], needed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ur_controller.VERSIONS, "5", version)
    (found,) = bad(examined(tmp_path, lambda emulator: None))
    assert found.what == "PSM1: version" and needed in found.cure


def test_a_clock_that_drifts_by_5_percent_is_named() -> None:
    rng = np.random.default_rng(1)
    stamps = DT * np.arange(2000)
    exchange = checkup.Exchange.of(stamps, stamps / 1.05 + rng.uniform(0.0, 0.003, 2000))
    clock = checkup.exchange_findings(exchange, True)[1]
    assert clock.what == "clock" and clock.good is False and "restart" in clock.cure


def test_nobody_and_somebody_else_at_the_address_are_told_apart(tmp_path: Path) -> None:
    arm = surg_core.load_cell(emulated_cell(tmp_path, emulated_ur.free_address())).arms["PSM1"]
    (nobody,) = ur_checkup.examine(arm, 0.1)
    assert nobody.good is False and "refused" in nobody.text and nobody.cure
    with socket.create_server((arm.hardware.address, dashboard.DASHBOARD_PORT)) as server:
        server.settimeout(5.0)
        answer = threading.Thread(target=lambda: server.accept()[0].sendall(b"SSH-2.0\n"))
        answer.start()
        (somebody,) = ur_checkup.examine(arm, 0.1)
        answer.join()
    assert somebody.good is False and "something else than a UR" in somebody.text


def test_a_broken_cell_is_one_finding(tmp_path: Path) -> None:
    folder = emulated_cell(tmp_path, "8.8.8.8")
    (found,) = bad(robot_doctor.findings(str(folder), None, 0.1))
    assert "hardware.address" in found.text and "8.8.8.8" in found.text


OWN = Route("eth1", ipaddress.IPv4Network("192.168.56.0/24"), ipaddress.IPv4Address(0))
OTHER = Route("eth0", ipaddress.IPv4Network("0.0.0.0/0"), ipaddress.IPv4Address("10.0.0.1"))


@pytest.mark.parametrize(
    ("table", "plugged", "word"),
    [
        ([OWN, OTHER], True, ""),
        ([OWN, OTHER], False, "carrier"),
        ([OTHER], True, "behind the gateway 10.0.0.1"),
        ([], True, "no interface"),
        ([OWN, dataclasses.replace(OTHER, interface="eth1")], True, "has a gateway too"),
    ],
)
def test_the_robots_cable_has_an_interface_of_its_own(
    table: list[Route], plugged: bool, word: str
) -> None:
    found = robot_doctor.cable("192.168.56.2", table, lambda interface: plugged)
    assert found.good == (not word) and word in found.text
    assert bool(found.cure) == bool(word)


def test_a_priority_that_is_not_granted_keeps_a_real_arm_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(checkup.resource, "getrlimit", lambda _: (0, 0))
    monkeypatch.setattr(checkup.os, "geteuid", lambda: 1000)
    real = checkup.real_time_finding(40, False)
    assert real.good is False and "rtprio 40" in real.cure
    assert checkup.real_time_finding(40, True).good is None


def test_late_states_are_bad_on_a_real_cable() -> None:
    """Every 20th state is 8 ms late; the clock runs 0.1 % fast."""
    stamps = DT * np.arange(1000)
    arrivals = stamps / 1.001 + np.where(np.arange(1000) % 20 == 7, 0.008, 0.0)
    exchange = checkup.Exchange.of(stamps, arrivals)
    assert exchange.drift == pytest.approx(0.001, abs=2e-5)
    assert exchange.late.max() == pytest.approx(0.008, abs=1e-4)
    assert [line.good for line in checkup.exchange_findings(exchange, False)] == [False, True]
    assert [line.good for line in checkup.exchange_findings(exchange, True)] == [None, True]


def test_the_age_of_a_calibration_is_told() -> None:
    arm = surg_core.load_cell(BUNDLED).arms["PSM1"]
    tool, trocar = checkup.calibration_findings(arm, datetime.date(2026, 11, 23))
    assert "computed, 2 days old" in tool.text and "trocar" in trocar.what


def test_doctor_ends_with_1_where_a_line_is_bad(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(robot_doctor, "MEASURED_S", 0.1)
    controller = UrController(serial=SERIAL, q=HOME)
    with emulated_ur.in_process(controller) as emulator:
        folder = emulated_cell(tmp_path, emulator.address)
        assert surg("robot", str(folder), "doctor") == 0
        controller.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test")
        assert surg("robot", str(folder), "doctor") == 1
    said = capsys.readouterr().out
    assert "BAD  PSM1: condition: emergency stop" in said
    assert f"./surg robot {folder.name} on" in said
    assert "slider at 100 %, the robot's own limiter at 100 %" in said
