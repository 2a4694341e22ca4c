"""The drive on emulated servos, by the maker's SDK in simulated time: homing, motion, failures."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from helpers.hardware.servo_bench import DRIVE, OFFSETS, ServoBench, drive_file, servos
from surg_emulators.drive.servo_motor import RAD, TORQUE, Servo
from surg_hardware.drive.drive_session import PERIOD
from surg_hardware.drive.instrument_drive import DriveState
from surg_hardware.drive.motor_values import Failure

SOON = 0.25 - 0.106
"""[s] From a fault to the drive's word; the arm is at rest at most 53 cycles later (F31 of
``docs/results/faults.md``), within 0.25 s of the fault."""


@pytest.fixture
def bench(tmp_path: Path) -> ServoBench:
    return ServoBench(drive_file(tmp_path))


def true_joints(bench: ServoBench) -> np.ndarray:
    """Of the servos, by the matrix of the file (rad)."""
    ways = [1.0, 1.0, -1.5]
    pairs = zip(bench.line.servos, OFFSETS.values(), ways, strict=True)
    motors = [(servo.position - offset) / way for servo, offset, way in pairs]
    return np.array([[1, 0, 0], [0.6, 1, 0], [0.2, -0.4, 1]]) @ np.array(motors)


def test_nothing_turns_before_somebody_asks_for_it(bench: ServoBench) -> None:
    before = [servo.position for servo in bench.line.servos]
    bench.session.connect()
    bench.core.command({"pitch": 1.0, "jaw": 1.0})
    bench.until(lambda: False, 0.5)
    assert bench.core.status.state is DriveState.IDENTIFIED
    assert [servo.position for servo in bench.line.servos] == before
    assert not any(servo.table[TORQUE] for servo in bench.line.servos)


def test_homing_finds_zero_and_goals_are_reached(bench: ServoBench) -> None:
    bench.homed()
    assert true_joints(bench) == pytest.approx([0, 0, 0], abs=0.08)
    assert bench.core.status.q == pytest.approx(true_joints(bench), abs=0.02)
    goal = {"jaw": 0.7, "pitch": 0.5, "yaw": 0.1}
    bench.core.command(goal)
    bench.until(lambda: False, 1.0)
    assert bench.core.status.state is DriveState.RUNNING
    assert true_joints(bench) == pytest.approx([0.5, 0.1, 0.7], abs=0.01)
    assert bench.core.status.q == pytest.approx([0.5, 0.1, 0.7], abs=0.01)
    assert bench.bus.lost == 0


def test_the_bus_manages_a_hundred_cycles_a_second(bench: ServoBench) -> None:
    """At 1 Mbit/s with the delays of servos and line: no cycle takes longer than its 10 ms."""
    bench.homed()
    begun, cycles = bench.port.time, bench.cycles
    bench.until(lambda: False, 1.0)
    assert bench.cycles - cycles >= (bench.port.time - begun) / PERIOD - 2


def test_a_bound_of_current_reaches_the_motor(bench: ServoBench) -> None:
    bench.session.connect()
    assert [servo.get("current_limit") for servo in bench.line.servos] == [223, 223, 149]
    bench.core.home()
    bench.until(lambda: False, 0.2)
    assert bench.line.servos[0].get("goal_current") == 74, "0.2 A while it is homed"


def test_a_motor_without_a_stop_ends_the_homing(tmp_path: Path) -> None:
    bench = ServoBench(drive_file(tmp_path), [Servo(i) for i in OFFSETS])
    bench.session.connect()
    bench.core.home()
    bench.until(lambda: bench.core.status.state is DriveState.FAILED, 10.0)
    assert "motor 1 (pitch): finds no stop (within 2 rad)" in bench.core.status.sentence


def test_a_motor_that_stands_without_current_is_not_at_a_stop(bench: ServoBench) -> None:
    bench.session.connect()
    bench.core.home()
    bench.until(lambda: bench.line.servos[0].table[TORQUE] == 1, 1.0)
    bench.line.servos[0].table[TORQUE] = 0  # its power stage is broken: it says nothing of it
    bench.until(lambda: bench.core.status.state is DriveState.FAILED, 10.0)
    assert "motor 1 (pitch): does not turn (while it seeks" in bench.core.status.sentence


def test_lost_answers_are_counted_and_borne(bench: ServoBench) -> None:
    bench.homed()
    for fault in ("damage 0.05", "noise 0.1", "loss 0.05"):
        assert bench.line.schedule.answer(fault, bench.port.time) == "ok"
    bench.core.command({"pitch": 0.4})
    known = []

    def keep() -> bool:
        known.append(bool(bench.core.status.q))
        return False

    bench.until(keep, 3.0)
    assert bench.core.status.state is DriveState.RUNNING
    assert 30 < bench.bus.lost < 200
    assert 30 < known.count(False) <= bench.bus.lost, "an old angle is not said again"
    assert true_joints(bench)[0] == pytest.approx(0.4, abs=0.01)


def test_jaws_that_grip_are_no_stall_and_keep_their_force(bench: ServoBench) -> None:
    bench.homed()
    bench.core.command({"jaw": 0.8})
    bench.until(lambda: False, 1.0)
    assert bench.line.schedule.answer("stall 3 on", bench.port.time) == "ok"
    bench.core.command({"jaw": 0.2})
    bench.until(lambda: False, 1.0)
    assert bench.core.status.state is DriveState.RUNNING
    assert abs(bench.line.servos[2].get("current")) == 149, "its bound, 0.4 A"
    assert bench.line.schedule.answer("heat 1 70", bench.port.time) == "ok"
    bench.until(lambda: False, 1.0)
    assert bench.core.status.state is DriveState.FAILED
    assert abs(bench.line.servos[2].get("current")) == 149, "the needle is not dropped"
    bench.line.servos[0].put("temperature", 30)


def test_a_cycle_that_stood_still_is_named(bench: ServoBench) -> None:
    bench.homed()
    bench.port.wait(bench.port.time + 0.19)
    bench.cycle()
    assert bench.core.status.state is DriveState.HOMED
    bench.port.wait(bench.port.time + 0.21)
    bench.cycle()
    assert "motor 1 (pitch): has heard nothing for 0.2 s" in bench.core.status.sentence


def test_a_silent_motor_keeps_no_other_one_from_turning_freely(bench: ServoBench) -> None:
    """While the second one is homed, the first one is unplugged: both lose their torque."""
    bench.session.connect()
    bench.core.home()
    bench.until(lambda: bench.line.servos[1].table[TORQUE] == 1, 20.0)
    bench.line.schedule.answer("unplug 1", bench.port.time)
    bench.until(lambda: bench.core.status.state is DriveState.FAILED, 1.0)
    assert "motor 1 (pitch): does not answer" in bench.core.status.sentence
    bench.cycle()
    bench.cycle()
    assert not bench.line.servos[1].table[TORQUE]


def test_a_failure_latches_until_the_next_homing(bench: ServoBench) -> None:
    bench.homed()
    bench.line.schedule.answer("overload 2", bench.port.time)
    bench.until(lambda: bench.core.status.state is DriveState.FAILED, SOON)
    bench.core.command({"pitch": 0.5})
    bench.core.home()
    bench.until(lambda: False, 0.5)
    assert bench.core.status.state is DriveState.FAILED
    bench.homed()  # it connects anew, which restarts the motor
    assert bench.line.servos[1].table[TORQUE] == 1


KINDS: dict[str, tuple[str, Failure]] = {
    "silence": ("loss 1", Failure.SILENT),
    "damage": ("damage 1", Failure.SILENT),
    "delay": ("delay 1", Failure.SILENT),
    "a motor unplugged": ("unplug {id}", Failure.SILENT),
    "the port unplugged": ("", Failure.UNPLUGGED),
    "a stall": ("stall {id} on", Failure.STALL),
    "a warm motor": ("heat {id} 70", Failure.OVERHEAT),
    "a hot motor": ("heat {id} 90", Failure.OVERHEAT),
    "a weak supply": ("voltage 10.4", Failure.VOLTAGE),
    "a dead supply": ("voltage 8", Failure.VOLTAGE),
    "an over-load": ("overload {id}", Failure.OVERLOAD),
}


@pytest.mark.parametrize("seed", range(30))
def test_a_drawn_fault_is_named_soon_and_the_jaws_do_as_stated(seed: int, tmp_path: Path) -> None:
    draw = random.Random(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    motor = draw.choice((1, 2) if kind == "a stall" else (1, 2, 3))
    stated = draw.choice(("hold", "open"))
    lag = draw.uniform(0.02, 0.06)
    bench = ServoBench(drive_file(tmp_path, {**DRIVE, "when_lost": stated}), servos(lag))
    bench.homed()
    begun, at = bench.port.time, draw.uniform(0.15, 0.4)

    def moving(until: float) -> None:
        while bench.port.time < until and bench.core.status.state is not DriveState.FAILED:
            t = 1.3 * (bench.port.time - begun)
            bench.core.command({"pitch": t, "yaw": -0.1 * t, "jaw": 0.5 * t})
            bench.cycle()

    moving(begun + at)
    line, failure = KINDS[kind]
    if line:
        assert bench.line.schedule.answer(line.format(id=motor), bench.port.time) == "ok"
    else:
        bench.port.unplugged = True
    struck = bench.port.time
    moving(struck + 1.0)
    assert bench.core.status.state is DriveState.FAILED
    assert bench.port.time - struck <= SOON
    assert failure in bench.core.status.sentence
    if "{id}" in line:
        assert f"motor {motor} (" in bench.core.status.sentence
    jaw = true_joints(bench)[2]
    if bench.port.unplugged:
        bench.port.wait(bench.port.time + 1.2)  # the motors' own watchdog
    else:
        bench.until(lambda: False, 1.2)
    after = true_joints(bench)[2]
    last = bench.line.servos[2]
    if stated == "open" and last.table[TORQUE] and not (last.unplugged or bench.port.unplugged):
        assert after == pytest.approx(1.0, abs=0.05)
    else:
        assert after == pytest.approx(jaw, abs=0.12), "no further than its lag"


def test_an_answer_that_the_sdk_unstuffs_wrongly_counts_as_lost(tmp_path: Path) -> None:
    """FF FF FD, and then FF FD FD in one answer."""
    bench = ServoBench(drive_file(tmp_path))
    bench.session.connect()
    servo = bench.line.servos[0]
    servo.hears = lambda now, baud: True  # type: ignore[method-assign]
    servo.table[126:136] = bytes.fromhex("FF FF FD 00 00 FF FD FD 00 00")
    assert sorted(bench.bus.exchange({})) == [2, 3]
    servo.table[126:136] = bytes.fromhex("FF FF FD FF FF FF FD 00 00 00")
    reading = bench.bus.exchange({})[1]
    assert reading.position == pytest.approx(0xFD * RAD)
    assert reading.velocity == pytest.approx(-3 * 0.229 * 2 * np.pi / 60)
