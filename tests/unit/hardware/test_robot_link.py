"""The link of an arm, cycle by cycle on a made-up clock: start, dead-man, latch, last check."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import pytest

from surg_hardware.conditions import Condition, Reading, ur_reading
from surg_hardware.robot_link import (
    Command,
    CommandPhase,
    LinkStep,
    RobotLink,
    RobotState,
    Settings,
)

T = 0.002
SETTINGS = Settings((3.14,) * 6, (38.0,) * 6, 0.04, 20.0)
READY = ur_reading(7, 1)
ZERO = (0.0,) * 6
MOTION = (0.3, -0.2, 0.1, 0.0, 0.05, -0.4)
FULL = os.environ.get("SURG_TEST_FULL") == "1"
LONGEST = 100_000
"""Cycles of a test."""


class Robot:
    """A robot that executes each command two cycles later, and its link."""

    def __init__(self, settings: Settings = SETTINGS) -> None:
        self.link = RobotLink(settings)
        self.k, self.steps = 1000, 0
        self.paused = 0  # cycles for which its clock has stood still
        self.reading: Reading = READY
        self.program = False
        self.executed = 0
        self.sent: list[tuple[int, tuple[float, ...]]] = []
        self.last: LinkStep | None = None

    @property
    def now(self) -> float:
        return T * self.k

    def command(self, qd: tuple[float, ...], age: float = 0.0) -> Command:
        return Command(qd, round(1e9 * self.now), self.now - age)

    def state(self) -> RobotState:
        zero = (0.0,) * 6
        time = self.now - T * self.paused
        return RobotState(time, zero, zero, self.reading, self.program, self.executed)

    def step(self, command: Command | None) -> LinkStep:
        self.k += 1
        self.steps += 1
        assert self.steps < LONGEST, "it goes on for ever"
        if self.program and len(self.sent) > 2:
            self.executed = self.sent[-2][0]
        step = self.link.step(self.state(), command, self.now)
        if step.qd is not None:
            self.sent.append((step.number, step.qd))
        self.last = step
        return step

    def run(self, cycles: int, qd: tuple[float, ...] = (0.0,) * 6) -> LinkStep:
        for _ in range(cycles):
            step = self.step(self.command(qd))
        return step

    def started(self) -> Robot:
        self.run(3)
        assert self.link.start(False, 10.0, self.now) == ""
        self.run(3)
        self.program = True
        assert self.run(5).status.condition is Condition.ACTIVE
        return self


def test_nothing_is_sent_before_the_start() -> None:
    robot = Robot()
    for _ in range(500):
        step = robot.step(robot.command(MOTION))
        assert step.qd is None and step.status.condition is Condition.READY
        assert "start" in step.status.fault


def test_started_it_obeys_and_names_the_last_command() -> None:
    robot = Robot().started()
    stamps = {}
    for _ in range(50):
        command = robot.command(MOTION)
        step = robot.step(command)
        stamps[step.number] = command.stamp_ns
        assert step.status.last_command_ns == stamps.get(
            robot.executed, step.status.last_command_ns
        )
    assert step.qd == MOTION
    assert step.status.fault == "" and not step.status.dead_man
    assert robot.executed in stamps


def test_a_start_with_nothing_that_answers_ends_by_itself() -> None:
    robot = Robot()
    robot.run(3)
    assert robot.link.start(False, 10.0, robot.now) == ""
    cycles = 0
    while robot.run(1).qd is not None:
        assert robot.last and robot.last.qd == (0.0,) * 6
        cycles += 1
    assert cycles == pytest.approx(3.0 / T, abs=3)
    assert not robot.link.active


@pytest.mark.parametrize(
    ("enabled", "known_for", "moved", "reading"),
    [
        (True, 10.0, math.inf, READY),
        (False, 1.9, math.inf, READY),
        (False, 10.0, 0.9, READY),
        (False, 10.0, math.inf, ur_reading(7, 3)),
        (False, 10.0, math.inf, ur_reading(7, 1, slider=0.5)),
        (False, 10.0, math.inf, ur_reading(5, 1)),
    ],
)
def test_start_is_refused(enabled: bool, known_for: float, moved: float, reading: Reading) -> None:
    robot = Robot()
    robot.reading = reading
    robot.run(3)
    if math.isfinite(moved):
        robot.step(robot.command(MOTION))
        robot.run(round(moved / T))
    assert robot.link.start(enabled, known_for, robot.now) != ""
    assert robot.run(3).qd is None


def test_start_is_accepted_a_second_after_the_last_motion() -> None:
    robot = Robot()
    robot.step(robot.command(MOTION))
    robot.run(round(1.0 / T) - 2)
    assert robot.link.start(False, 10.0, robot.now) != ""
    robot.run(2)
    assert robot.link.start(False, 10.0, robot.now) == ""


def test_a_silent_controller_is_ramped_down_on_a_straight_line_and_latched() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    command = robot.command(MOTION)
    path, times = np.zeros(6), 0
    while (step := robot.step(command)).qd is not None:
        path += T * np.array(step.qd)
        times += 1
    # 40 ms, then 0.4 rad/s at 20 rad/s^2: 20 ms.
    assert times == pytest.approx((0.04 + 0.02) / T, abs=1)
    direction = np.array(MOTION) / np.linalg.norm(MOTION)
    assert np.linalg.norm(path - (path @ direction) * direction) < 1e-12
    assert step.status.condition is Condition.READY and "40 ms" in step.status.fault
    for _ in range(1000):  # the controller is back: nothing moves before a person starts the arm
        assert robot.step(robot.command(MOTION)).qd is None


def test_the_controller_hears_of_the_dead_man_in_its_first_cycle() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    command = robot.command(MOTION)
    steps = [robot.step(command) for _ in range(22)]
    dead = [step.status.condition is not Condition.ACTIVE for step in steps]
    first = dead.index(True)
    assert first in (19, 20)  # 40 ms, give or take a rounding
    assert steps[first].status.dead_man and steps[first].qd != MOTION


def test_a_silent_controller_at_rest_is_waited_for() -> None:
    robot = Robot().started()
    command = robot.command((0.0,) * 6)
    for _ in range(100):
        step = robot.step(command)
    assert step.status.condition is Condition.ACTIVE and step.status.dead_man
    assert robot.run(1, MOTION).qd != (0.0,) * 6


STOPS = [
    ur_reading(3, 1), ur_reading(5, 1), ur_reading(7, 3), ur_reading(7, 5), ur_reading(7, 7),
    ur_reading(7, 9), ur_reading(7, 1, 1.0, True), ur_reading(99, 1),
]  # fmt: skip


@pytest.mark.parametrize("reading", STOPS)
def test_a_robot_that_stops_is_said_in_the_same_cycle_and_latched(reading: Reading) -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.reading = reading
    step = robot.run(1, MOTION)
    assert step.qd == ZERO and step.status.condition is reading.condition
    assert step.status.fault == reading.text
    robot.reading = READY  # unlocked; its program may even run again
    for _ in range(1000):
        step = robot.run(1, MOTION)
        assert step.qd is None and step.status.condition is Condition.READY
    assert robot.sent[-1] == (robot.sent[-2][0], ZERO)  # no new number: the program ends


def test_after_a_stop_and_a_start_nothing_of_before_is_obeyed() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.reading = ur_reading(7, 3)
    robot.run(600)
    robot.reading, robot.program = READY, False
    robot.run(3)
    assert robot.link.start(False, 10.0, robot.now) == ""
    robot.run(3)
    robot.program = True
    assert robot.run(100).status.condition is Condition.ACTIVE
    assert all(qd == (0.0,) * 6 for _, qd in robot.sent[-103:])


def test_a_program_that_ends_is_the_end() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.program = False
    assert robot.run(1, MOTION).qd == ZERO
    assert robot.run(1, MOTION).qd is None


def test_a_program_that_does_not_echo_is_the_end() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    frozen = robot.executed
    cycles = 0
    while robot.last is not None and robot.last.qd is not None:
        robot.k += 1
        state = replace(robot.state(), executed=frozen)
        robot.last = robot.link.step(state, robot.command(MOTION), robot.now)
        cycles += 1
        assert cycles < 100
    assert cycles == pytest.approx(0.04 / T, abs=2)


def test_a_slowed_robot_is_ramped_down_and_latched() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.reading = ur_reading(7, 1, slider=0.5)
    step = robot.run(1, MOTION)
    assert step.status.condition is Condition.SLOWED and step.status.speed_scaling == 0.5
    speeds = [max(map(abs, step.qd or ZERO))]
    while (step := robot.run(1, MOTION)).qd is not None:
        assert step.status.condition is Condition.SLOWED
        speeds.append(max(map(abs, step.qd)))
    assert speeds == sorted(speeds, reverse=True) and len(speeds) <= 0.4 / 20.0 / T + 2
    robot.reading = READY
    step = robot.run(5, MOTION)
    assert step.qd is None and "slider" in step.status.fault


def test_a_stall_of_the_driver_ends_the_motion_without_a_late_command() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.k += 250
    assert robot.run(1, MOTION).qd == ZERO
    assert robot.run(100, MOTION).qd is None


@pytest.mark.parametrize(
    ("gap", "paused", "who"),
    [(14, 13, ""), (18, 17, ""), (14, 0, "driver"), (14, 3, "driver"), (25, 24, "robot")],
)
def test_whose_stall_it_was_is_told_by_the_robots_clock(gap: int, paused: int, who: str) -> None:
    """A dead-man of 20 ms; the robot's clock stood still for so many of the gap's cycles."""
    robot = Robot(replace(SETTINGS, dead_man=0.02)).started()
    robot.run(50, MOTION)
    robot.k += gap - 1
    robot.paused = paused
    step = robot.run(1, MOTION)
    if not who:
        assert step.qd == MOTION and step.status.condition is Condition.ACTIVE
        assert robot.run(100, MOTION).status.condition is Condition.ACTIVE
        return
    assert step.qd == ZERO
    step = robot.run(100, MOTION)
    assert step.qd is None
    assert f"the {who} stood still for {2 * gap} ms" in step.status.fault


def test_lost_states_are_offline_and_latched() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    assert robot.link.lost().condition is Condition.OFFLINE
    step = robot.run(100, MOTION)
    assert step.qd is None and step.status.condition is Condition.READY


@pytest.mark.parametrize(
    "bad",
    [
        (0.0,) * 5,
        (0.0,) * 8,
        (),
        (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, math.inf, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 10.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0, -3.15),
    ],
)
def test_a_bad_command_is_refused_and_the_arm_is_ramped_down(bad: tuple[float, ...]) -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    before = np.array(MOTION)
    while (step := robot.run(1, bad)).qd is not None:
        assert np.abs(np.array(step.qd)).max() < np.abs(before).max() or step.qd == ZERO
        before = np.array(step.qd)
    assert step.status.condition is Condition.READY and "refused" in step.status.fault


def test_ending_ramps_down_before_the_driver_may_go() -> None:
    robot = Robot().started()
    robot.run(50, MOTION)
    robot.link.end("asked")
    cycles = 0
    while robot.link.active:
        robot.run(1, MOTION)
        cycles += 1
    assert cycles == pytest.approx(0.4 / 20.0 / T, abs=1)
    assert robot.sent[-1][1] == ZERO


@pytest.mark.parametrize("seed", range(200 if FULL else 10))
def test_whatever_comes_the_robot_gets_finite_bounded_smooth_commands(seed: int) -> None:
    """Random commands, silence, modes, stalls and starts; the wire keeps every limit."""
    rng = np.random.default_rng(seed)
    robot = Robot()
    command: Command | None = None
    last, last_k = np.zeros(6), 0
    moves = 0
    for _ in range(5000):
        if rng.random() < 0.9:
            scale = rng.choice([0.0, 0.1, 1.0, 3.0, 10.0], p=[0.5, 0.2, 0.2, 0.09, 0.01])
            qd = rng.uniform(-1, 1, 6) * scale
            if rng.random() < 0.001:
                qd[rng.integers(6)] = rng.choice([math.nan, math.inf])
            command = robot.command(tuple(qd.tolist()))
        if rng.random() < 0.002:
            robot.reading = STOPS[rng.integers(len(STOPS))]
        elif rng.random() < 0.05:
            robot.reading = READY
        if rng.random() < 0.002:
            robot.k += int(rng.integers(1, 60))
        if not robot.link.active and rng.random() < 0.02:
            robot.program = False
            robot.run(520)
            robot.link.start(False, 10.0, robot.now)
            robot.run(3)
            robot.program = True
        k, n = robot.k, len(robot.sent)
        step = robot.step(command)
        if step.qd is None:
            last, last_k = np.zeros(6), robot.k
            continue
        qd_sent = np.array(step.qd)
        assert np.isfinite(qd_sent).all() and (np.abs(qd_sent) <= 3.14).all()
        assert len(robot.sent) == n + 1
        if n and robot.sent[-1][0] == robot.sent[-2][0]:
            assert step.qd == ZERO
        if last_k == k:
            assert (np.abs(qd_sent - last) <= 38.0 * T + 1e-12).all() or not qd_sent.any()
        moves += int(qd_sent.any())
        last, last_k = qd_sent, robot.k
    assert moves > 100


@pytest.mark.parametrize("offset", np.arange(0.0, 2.0, 0.1))
def test_two_cycles_with_jitter_neither_repeat_nor_skip_commands(offset: float) -> None:
    """Commands come once per cycle at any offset from the states, with 0.1 ms of jitter."""
    rng = np.random.default_rng(round(10 * offset))
    phase, taken = CommandPhase(), []
    arrivals = [2e-3 * k + 1e-3 * offset + rng.uniform(-1e-4, 1e-4) for k in range(2000)]
    for k in range(5, 1990):
        state = 2e-3 * k
        newest = max(n for n in range(k - 3, k + 3) if arrivals[n] <= state)
        wait = phase.wait(state - arrivals[newest])
        assert 0 <= wait <= 1.4e-3
        if wait and arrivals[newest + 1] <= state + wait:
            newest += 1
        taken.append(newest)
    steps = np.diff(taken[10:])
    assert (steps != 1).sum() == 0
