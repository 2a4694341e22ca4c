"""What the motion generator of an emulated Franka arm refuses, cycle by cycle on a fake clock."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from helpers.hardware.emulated_franka import JOINT_POSITION, Client, connected, moving, ramp
from surg_emulators.franka.franka_controller import RobotMode
from surg_emulators.franka.franka_errors import Error, Violation
from surg_emulators.franka.franka_robots import FER, FR3, HOME, ROBOTS, FrankaRobot
from surg_emulators.franka.generator_motion import DT, GeneratorMotion

CYCLES = 250_000 if os.environ.get("SURG_TEST_FULL") == "1" else 4_000
BOTH = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
JUST = 1.0 - 1e-6


def refused(client: Client) -> list[str]:
    """Errors that ended the motion; the client has been told so."""
    assert client.answers[-1:] == [("move", "reflex")]
    state = client.state()
    assert state.mode == RobotMode.REFLEX
    assert state.errors == state.reflex
    return state.errors


@BOTH
@pytest.mark.parametrize("joint", range(7))
def test_acceleration_up_to_the_limit_and_not_beyond(robot: FrankaRobot, joint: int) -> None:
    """At the limit of jerk first, then of acceleration; then 0.1 % more."""
    motion = GeneratorMotion(robot, list(HOME))
    most, jerk, speed = robot.acceleration[joint], robot.jerk[joint], 0.0
    for rate in [*np.arange(jerk * DT, most, jerk * DT), *[most] * 20]:
        speed += JUST * rate * DT
        motion.velocity_command([speed if each == joint else 0.0 for each in range(7)])
    assert motion.ddq_d[joint] == pytest.approx(most, rel=1e-5)
    faster = speed + 1.001 * most * DT
    with pytest.raises(Violation, match=f"joint {joint + 1}: acceleration") as found:
        motion.velocity_command([faster if each == joint else 0.0 for each in range(7)])
    assert found.value.error is Error.joint_motion_generator_velocity_discontinuity


@BOTH
@pytest.mark.parametrize("joint", range(7))
def test_jerk_up_to_the_limit_and_not_beyond(robot: FrankaRobot, joint: int) -> None:
    for factor, stays in ((JUST, True), (1.001, False)):
        motion = GeneratorMotion(robot, list(HOME))
        speed = factor * robot.jerk[joint] * DT**2
        command = [speed if each == joint else 0.0 for each in range(7)]
        if stays:
            motion.velocity_command(command)
            continue
        with pytest.raises(Violation, match=f"joint {joint + 1}: jerk") as found:
            motion.velocity_command(command)
        assert found.value.error is Error.joint_motion_generator_acceleration_discontinuity
        assert motion.dq_d == [0.0] * 7  # not executed


@BOTH
@pytest.mark.parametrize("joint", [0, 5])
def test_velocity_up_to_the_limit_and_not_beyond(robot: FrankaRobot, joint: int) -> None:
    client = moving(robot)
    client.controller.motion.q_d[joint] -= 0.5  # room until the limit of position
    low, high = robot.velocity_range(joint, client.controller.motion.q_d[joint])
    speed, speeds = 0.0, ramp(robot, 5000, joint)
    for command in speeds:
        client.step(command)
        if client.controller.mode is RobotMode.REFLEX:
            break
        speed = command[joint]
        low, high = robot.velocity_range(joint, client.controller.motion.q_d[joint])
    assert refused(client) == ["joint_motion_generator_velocity_limits_violation"]
    assert high - 0.02 < speed <= high
    assert low < 0.0


def test_an_fr3_is_slower_near_its_position_limits_and_an_fer_is_not() -> None:
    """Franka's published formula, worked out by hand for joint 1 at 2.7 rad."""
    up = math.sqrt(12.0 * (2.75010 - 2.7)) - 0.30
    assert FR3.velocity_range(0, 2.7) == pytest.approx((-2.62, up))
    assert FR3.velocity_range(0, -2.7) == pytest.approx((-up, 2.62))
    assert FR3.velocity_range(0, 2.7437)[1] == 0.0
    assert FR3.velocity_range(0, 0.0) == (-2.62, 2.62)
    assert FER.velocity_range(0, 2.8) == (-2.175, 2.175)


@BOTH
@pytest.mark.parametrize(("joint", "sign"), [(0, 1.0), (1, -1.0), (3, 1.0)])
def test_a_position_limit_ends_the_motion(robot: FrankaRobot, joint: int, sign: float) -> None:
    limit = (robot.position_max if sign > 0.0 else robot.position_min)[joint]
    motion = GeneratorMotion(robot, list(HOME))
    motion.q_d[joint] = limit - sign * 1e-9
    slow = sign * 0.5 * robot.jerk[joint] * DT**2
    with pytest.raises(Violation) as found:
        motion.velocity_command([slow if each == joint else 0.0 for each in range(7)])
    named = {Error.joint_motion_generator_position_limits_violation}
    if robot is FR3:  # its velocity limit is zero there
        named.add(Error.joint_motion_generator_velocity_limits_violation)
    assert found.value.error in named


@BOTH
def test_a_motion_starts_at_rest(robot: FrankaRobot) -> None:
    client = connected(robot)
    client.move()
    client.step([0.1] + [0.0] * 6)
    assert refused(client) == ["joint_motion_generator_velocity_discontinuity"]
    assert client.controller.motion.q_d == list(HOME)


@BOTH
def test_a_motion_ends_at_rest(robot: FrankaRobot) -> None:
    client = moving(robot)
    speeds = ramp(robot, 200)
    for command in speeds:
        client.step(command)
    client.step(speeds[-1], last=True)
    assert refused(client) == ["joint_motion_generator_velocity_discontinuity"]

    client = moving(robot)
    for command in [*speeds, *reversed(speeds), [0.0] * 7]:
        client.step(command)
    client.step(last=True)
    client.wait(200)
    assert client.answers == [("move", "success")]
    assert client.state().mode == RobotMode.IDLE


@BOTH
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("generator", [0, 1])
def test_a_command_that_is_no_number_ends_the_motion(
    robot: FrankaRobot, value: float, generator: int
) -> None:
    client = moving(robot, generator)
    q = list(client.controller.motion.q_d)
    client.step([value] + [0.0] * 6, [value, *q[1:]])
    assert len(refused(client)) == 1
    assert np.isfinite(client.controller.motion.q_d).all()


@BOTH
def test_joint_positions_move_the_arm_and_must_begin_where_it_is(robot: FrankaRobot) -> None:
    client, place = moving(robot, JOINT_POSITION), list(HOME)
    for rate in [*ramp(robot, 200), *reversed(ramp(robot, 200))]:
        place = [now + DT * each for now, each in zip(place, rate, strict=True)]
        client.step(q=place)
    client.step(q=place)
    client.step(q=place, last=True)
    client.wait(200)
    assert client.answers == [("move", "success")]
    assert client.state().values["q"][0] == pytest.approx(place[0], abs=1e-6)

    client = connected(robot)
    client.move(JOINT_POSITION)
    client.step(q=[HOME[0] + 0.01, *HOME[1:]])
    assert refused(client) == ["joint_position_motion_generator_start_pose_invalid"]


@BOTH
def test_random_commands_within_the_limits_are_all_obeyed(robot: FrankaRobot) -> None:
    """Random velocities through a rate limiter of the test's own; then finite differences."""
    rng = np.random.default_rng(20)
    motion = GeneratorMotion(robot, list(HOME))
    low, high = np.array(robot.position_min), np.array(robot.position_max)
    most, jerk = 0.9 * np.array(robot.acceleration), 0.9 * np.array(robot.jerk)
    wanted, dq, ddq, centre = np.zeros(7), np.zeros(7), np.zeros(7), np.array(HOME)
    worst = np.zeros(3)
    for cycle in range(CYCLES):
        if cycle % 100 == 0:
            wanted = np.clip(2.0 * (centre - motion.q_d) + rng.uniform(-0.2, 0.2, 7), -0.5, 0.5)
        error = wanted - dq
        step = np.sign(error) * np.minimum(most, np.sqrt(np.abs(error) * jerk))
        ddq = ddq + np.clip(step - ddq, -jerk * DT, jerk * DT)
        dq = dq + DT * ddq
        before, rate = list(motion.dq_d), list(motion.ddq_d)
        motion.velocity_command(dq.tolist())
        change = (np.array(motion.dq_d) - before) / DT
        worst = np.maximum(
            worst,
            [
                np.max(np.abs(motion.dq_d) / np.array(robot.velocity)),
                np.max(np.abs(change) / robot.acceleration),
                np.max(np.abs(change - rate) / DT / robot.jerk),
            ],
        )
    assert (np.array(motion.q_d) > low).all() and (np.array(motion.q_d) < high).all()
    assert (worst <= 0.9 + 1e-6).all() and worst[2] > 0.8
    print(f"{CYCLES} cycles: largest shares of velocity, acceleration, jerk {worst.round(3)}")


@BOTH
def test_random_steps_are_refused_exactly_where_they_break_a_limit(robot: FrankaRobot) -> None:
    """One random step from a random motion, judged by finite differences."""
    rng = np.random.default_rng(21)
    most, jerk = np.array(robot.acceleration), np.array(robot.jerk)
    counts = {True: 0, False: 0}
    for _ in range(CYCLES // 4):
        motion = GeneratorMotion(robot, list(HOME))
        motion.dq_d = rng.uniform(-0.2, 0.2, 7).tolist()
        motion.ddq_d = (rng.uniform(-0.9, 0.9, 7) * most).tolist()
        ddq = motion.ddq_d + rng.uniform(-1.1, 1.1, 7) * jerk * DT
        change = (np.abs(ddq) - most) / most, (np.abs(ddq - motion.ddq_d) / DT - jerk) / jerk
        beyond = max(change[0].max(), change[1].max())
        if abs(beyond) < 3e-4:  # an FR3 allows for the rounding of its states
            continue
        try:
            motion.velocity_command((np.array(motion.dq_d) + DT * ddq).tolist())
            executed = True
        except Violation:
            executed = False
        assert executed == (beyond < 0.0), (beyond, ddq)
        counts[executed] += 1
    assert min(counts.values()) > CYCLES // 40
    print(counts)
