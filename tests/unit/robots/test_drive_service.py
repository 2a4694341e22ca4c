"""`./surg robot CELL drive` and the doctor of a drive, on emulated servos in simulated time."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

import surg_core
from helpers.hardware.servo_bench import OFFSETS, MemoryPort, emulated_drive_cell, servos
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_cli.robots import drive_service, robot_doctor
from surg_emulators.drive.servo_line import ServoLine
from surg_emulators.drive.servo_motor import TORQUE, Servo
from surg_hardware.drive import drive_checkup, drive_session
from surg_hardware.drive.drive_file import drive_of

Plug = Callable[[list[Servo]], ServoLine]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return emulated_drive_cell(tmp_path)


@pytest.fixture
def plug(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plug]:
    """Connects servos to the drive's port, and makes its time everybody's."""

    def connect(motors: list[Servo]) -> ServoLine:
        line = ServoLine(motors)
        port = drive_of(surg_core.load_cell(folder), "PSM1").port
        port.touch()
        monkeypatch.setattr(drive_checkup, "SerialPort", lambda _, baud: MemoryPort(line, baud))
        monkeypatch.setattr(drive_session, "SerialPort", lambda _, baud: MemoryPort(line, baud))
        clock = SimpleNamespace(
            monotonic=lambda: line.now, sleep=lambda dt: line.step(line.now + dt)
        )
        monkeypatch.setattr(drive_session, "time", clock)
        monkeypatch.setattr(drive_service, "time", clock)
        return line

    yield connect
    drive_of(surg_core.load_cell(folder), "PSM1").port.unlink(missing_ok=True)


def serve(word: str | None, folder: Path) -> int:
    return drive_service.serve(word, folder, surg_core.load_cell(folder), ["PSM1"], None)


def findings(folder: Path) -> list[str]:
    """What is bad about the drive, one sentence each."""
    found = robot_doctor.of_drive(surg_core.load_cell(folder), "PSM1")
    return [f"{each.what}: {each.text}: {each.cure}" for each in found if each.good is False]


def says(monkeypatch: pytest.MonkeyPatch, word: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(3 * f"{word}\n"))


def test_a_good_drive_has_no_bad_finding(folder: Path, plug: Plug) -> None:
    line = plug(servos())
    assert findings(folder) == []
    assert not any(servo.table[TORQUE] for servo in line.servos)


BAD: dict[str, tuple[list[Servo], str]] = {
    "a wrong baud": (
        [Servo(i, baud=57_600) for i in OFFSETS],
        r"motor 1 \(XM430-W350\) answers at 57600 bit/s; the file says 1000000: connect one",
    ),
    "a wrong model": (
        [Servo(1, model=1060), Servo(2), Servo(3)],
        "motors.pitch.model: motor 1 is model 1060; the file says XM430-W350",
    ),
    "two motors with one id": (
        [Servo(1), Servo(2, position=1.0), Servo(2), Servo(3)],
        "two motors answer as 2, or its line is bad: connect one motor at a time: .* drive id",
    ),
    "a motor that is not there": ([Servo(1), Servo(3)], "motor 2 does not answer at 1000000"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_the_doctor_names_what_is_wrong(what: str, folder: Path, plug: Plug) -> None:
    motors, sentence = BAD[what]
    plug(motors)
    found = findings(folder)
    assert any(re.search(sentence, each) for each in found), found


def test_the_doctor_names_a_missing_port_and_a_bad_file(folder: Path) -> None:
    (said,) = findings(folder)
    assert "no such port" in said and "./surg emulate CELL" in said
    (folder / "drive_PSM1.yaml").write_text("format: surg_drive/1\n", "utf-8")
    (said,) = findings(folder)
    assert "drive_PSM1.yaml" in said and "port: is missing" in said


def test_find_lists_motors_at_any_baud(
    folder: Path, plug: Plug, capsys: pytest.CaptureFixture[str]
) -> None:
    plug([Servo(1), Servo(9, baud=57_600)])
    assert serve("find", folder) == 0
    said = capsys.readouterr().out
    assert "2 motors" in said and "motor 1 (pitch)" in said
    assert "57600 bit/s" in said and "motor 9" in said


def test_id_gives_each_motor_its_own(
    folder: Path, plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All are new: the person connects one after the other."""
    new = [Servo(1, baud=57_600) for _ in range(3)]
    line, waiting = plug([]), list(new)

    def next_one(question: str) -> None:
        line.servos[:] = [waiting.pop(0)]

    monkeypatch.setattr(drive_service, "confirm", next_one)
    assert serve("id", folder) == 0
    assert [(servo.id, servo.baud) for servo in new] == [(i, 1_000_000) for i in (1, 2, 3)]


def test_two_motors_on_the_line_get_no_id(
    folder: Path, plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug([Servo(5), Servo(6)])
    says(monkeypatch, "yes")
    with pytest.raises(CliError, match=r"5 \(XM430.*6 \(XM430.*allowed: one XM430-W350"):
        serve("id", folder)


def test_the_test_turns_each_joint_after_a_yes_only(
    folder: Path, plug: Plug, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    line = plug(servos())
    before = [servo.position for servo in line.servos]
    says(monkeypatch, "no")
    with pytest.raises(CliError, match="not confirmed"):
        serve("test", folder)
    assert [servo.position for servo in line.servos] == before
    says(monkeypatch, "yes")
    assert serve("test", folder) == 0
    said = capsys.readouterr().out
    assert all(f"{joint}" in said for joint in ("pitch", "yaw", "jaw"))
    assert "to 0.2 rad  off by 0.00" in said and " 0 lost" in said
    assert not any(servo.table[TORQUE] for servo in line.servos)


def test_a_test_that_fails_names_the_motor(
    folder: Path, plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug([Servo(i) for i in OFFSETS])
    says(monkeypatch, "yes")
    with pytest.raises(CliError, match=r"PSM1: FAILED: motor 1 \(pitch\): finds no stop"):
        serve("test", folder)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (None, "one word is missing: find, id, home, test"),
        ("home", "the system of .* is not running: ./surg up"),
    ],
)
def test_a_word_that_cannot_be_done_is_refused(word: str | None, said: str, folder: Path) -> None:
    with pytest.raises(CliError, match=said):
        serve(word, folder)


def test_an_arm_without_a_drive_is_refused() -> None:
    folder = paths.CELLS / "emulated_ur5e"
    with pytest.raises(CliError, match="tool_link: is not 'drive'") as caught:
        serve("find", folder)
    assert caught.value.code == 2
