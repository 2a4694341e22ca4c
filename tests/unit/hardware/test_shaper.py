"""The shaper of Franka commands: never above the published limits, whatever is commanded or lost.

The judge is the robot's own arithmetic: finite differences of the desired velocities, with constant
acceleration where a command is lost. ``SURG_TEST_FULL=1`` draws a million commands per arm.
"""

from __future__ import annotations

import math
import os
import random

import pytest

from surg_emulators.franka import franka_robots
from surg_hardware.franka.joint_limits import FR3, PANDA
from surg_hardware.shaper import Shaper

T = 0.001
FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
COMMANDS = 1_000_000 if FULL else 4000
ARMS = {"fr3": FR3, "panda": PANDA}
ROBOTS = {"fr3": franka_robots.FR3, "panda": franka_robots.FER}
ROUNDING = 1e-9


class Robot:
    """The motion generator of a Franka: it extrapolates what it misses.

    Attributes:
        excess: Largest velocity, acceleration and jerk so far, each as a share of its limit.
    """

    def __init__(self, name: str) -> None:
        self.limits, self.arm = ARMS[name], ROBOTS[name]
        limits = self.limits
        self.q = [0.5 * (joint.lower + joint.upper) for joint in limits]
        self.dq_d = [0.0] * len(limits)
        self.ddq_d = [0.0] * len(limits)
        self.excess = [0.0, 0.0, 0.0]

    def take(self, velocities: tuple[float, ...]) -> None:
        """A command that arrives."""
        for i, (joint, v) in enumerate(zip(self.limits, velocities, strict=True)):
            a = (v - self.dq_d[i]) / T
            jerk = (a - self.ddq_d[i]) / T
            limit = abs(self.arm.velocity_range(i, self.q[i])[v > 0])
            shares = abs(v) / max(limit, 1e-3), abs(a) / joint.acceleration, abs(jerk) / joint.jerk
            self.excess = [max(pair) for pair in zip(self.excess, shares, strict=True)]
            self.dq_d[i], self.ddq_d[i] = v, a
            self.q[i] += v * T

    def miss(self) -> None:
        """A command that is lost."""
        for i, a in enumerate(self.ddq_d):
            self.dq_d[i] += a * T
            self.q[i] += self.dq_d[i] * T


def play(name: str, commands: int, loss: float, seed: int) -> Robot:
    """Random commands, some of them absurd, each for a random time."""
    rng = random.Random(seed)
    robot = Robot(name)
    shaper = Shaper(robot.limits)
    left = commands
    while left > 0:
        wanted = [rng.uniform(-1.3, 1.3) * joint.velocity for joint in robot.limits]
        quiet = rng.random() < 0.2
        for _ in range(rng.choice((1, 2, 5, 40, 400))):
            sent = shaper.shape([0.0] * 7 if quiet else wanted, robot.q, robot.dq_d, robot.ddq_d)
            if rng.random() < loss:
                robot.miss()
            else:
                robot.take(sent)
            left -= 1
    return robot


@pytest.mark.parametrize("name", ARMS)
def test_random_commands_stay_within_velocity_acceleration_and_jerk(name: str) -> None:
    robot = play(name, COMMANDS, 0.0, 1)
    velocity, acceleration, jerk = robot.excess
    print(f"{COMMANDS} commands: {velocity:.3f} {acceleration:.3f} {jerk:.3f} of the limits")
    assert velocity <= 1.0 and acceleration <= 0.95 + ROUNDING and jerk <= 0.8 + 1e-6
    assert acceleration > 0.9 and jerk > 0.7, "the commands ask for more than the arm can do"


@pytest.mark.parametrize("name", ARMS)
def test_after_lost_commands_acceleration_and_jerk_stay_within_the_limits(name: str) -> None:
    robot = play(name, COMMANDS // 2, 0.05, 2)
    assert robot.excess[1] <= 0.95 + ROUNDING and robot.excess[2] <= 0.8 + 1e-6


def test_a_command_is_reached_soon_and_without_overshoot() -> None:
    robot = Robot("panda")
    shaper = Shaper(PANDA)
    wanted = [0.1, -0.05, 0.02, 0.1, -0.1, 0.2, 0.3]
    for cycle in range(60):
        robot.take(shaper.shape(wanted, robot.q, robot.dq_d, robot.ddq_d))
        over = [math.copysign(1.0, u) * (v - u) for v, u in zip(robot.dq_d, wanted, strict=True)]
        assert max(over) < 1.1e-3, cycle  # rad/s, an eighth of what the jerk allows in a cycle
    assert min(over) > -1e-4


def test_a_gentle_motion_passes_two_milliseconds_late_at_most() -> None:
    """Where nothing bites, the shaper only interpolates."""
    robot, shaper, late = Robot("panda"), Shaper(PANDA), []
    for cycle in range(2000):
        t = T * (cycle - cycle % 2)
        wanted = [0.05 * math.sin(2.0 * t)] * 7
        robot.take(shaper.shape(wanted, robot.q, robot.dq_d, robot.ddq_d))
        if cycle > 20:
            late.append(robot.dq_d[0] - 0.05 * math.sin(2.0 * T * (cycle - 1)))
    assert max(map(abs, late)) < 0.05 * 2.0 * 1.5e-3


def test_a_joint_stops_before_the_end_of_its_range() -> None:
    for name, limits in ARMS.items():
        robot, shaper = Robot(name), Shaper(limits)
        for _ in range(6000):
            wanted = [joint.velocity for joint in limits]
            robot.take(shaper.shape(wanted, robot.q, robot.dq_d, robot.ddq_d))
        for q, joint in zip(robot.q, limits, strict=True):
            assert joint.upper - 0.05 < q < joint.upper
        assert max(map(abs, robot.dq_d)) < 1e-2 and robot.excess[0] <= 1.0
