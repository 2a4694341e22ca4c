"""Modes, commands and lost packets of an emulated Franka arm, on a fake clock."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from helpers.hardware.emulated_franka import REST, Client, connected, moving, ramp
from surg_emulators.franka.fci_messages import HEADER, PROTOCOLS
from surg_emulators.franka.franka_controller import (
    MOST_LOST,
    RECOVERY_CYCLES,
    START_CYCLES,
    UNLOCK_CYCLES,
    FrankaController,
    RobotMode,
)
from surg_emulators.franka.franka_errors import Error
from surg_emulators.franka.franka_kinematics import from_columns
from surg_emulators.franka.franka_robots import FER, FR3, HOME, ROBOTS, FrankaRobot
from surg_emulators.franka.generator_motion import DT, LAGS, STIFFNESS

BOTH = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
LOST = ["communication_constraints_violation"]


def at_speed(robot: FrankaRobot, cycles: int = 100) -> Client:
    """A client in the middle of a motion of joint 1, at constant acceleration."""
    client = moving(robot)
    for command in ramp(robot, cycles):
        client.step(command)
    return client


def come_to_rest(client: Client) -> float:
    """Let the arm come to rest without commands; the way of joint 1 [rad]."""
    before = client.controller.motion.q[0]
    client.wait(500)
    assert client.controller.motion.at_rest
    return client.controller.motion.q[0] - before


def braking_way(robot: FrankaRobot, speed: float) -> float:
    """Way of joint 1 that a stop may take [rad]: braking, lag and a cycle."""
    return 1.1 * speed**2 / (2.0 * 0.9 * robot.acceleration[0]) + speed * 0.01


# -- connecting


@BOTH
def test_sizes_of_the_published_messages(robot: FrankaRobot) -> None:
    protocol = PROTOCOLS[robot.version]
    sizes = protocol.state.size, protocol.command.size
    assert sizes == {5: (2373, 370), 10: (1377, 371)}[robot.version]


@BOTH
def test_places_of_a_state_that_the_makers_library_reads(robot: FrankaRobot) -> None:
    """Bytes counted by hand in the published structures; the oracle reads the same ones."""
    client = moving(robot)
    for command in ramp(robot, 3):
        client.step(command)
    client.controller.reflex(Error.joint_reflex, "test")
    data, motion = client.controller.state(), client.controller.motion
    code, size, errors = {5: ("d", 8, 2282), 10: ("f", 4, 1290)}[robot.version]
    for first, wanted in ((147, motion.q), (154, motion.q_d), (161, motion.dq), (168, motion.dq_d)):
        assert struct.unpack_from(f"<7{code}", data, 8 + first * size) == pytest.approx(wanted)
    assert struct.unpack_from("<Q", data)[0] == client.controller.number
    assert data[errors + 6] == data[errors + 41 + 6] == 1
    assert data[errors + 82] == RobotMode.REFLEX


@BOTH
@pytest.mark.parametrize("other", [0, 4, 6, 9, 11, 65535])
def test_another_version_is_refused_and_told_the_arms_own(robot: FrankaRobot, other: int) -> None:
    client = Client(FrankaController(robot))
    data = client.session.receive(HEADER.pack(0, 7, 16) + struct.pack("<HH", other, 4000))
    assert data == HEADER.pack(0, 7, 15) + struct.pack("<BH", 1, robot.version)
    assert client.session.udp_port == 0


@BOTH
def test_nothing_is_answered_before_connect(robot: FrankaRobot) -> None:
    client = Client(FrankaController(robot))
    assert client.move() == ""
    assert client.session.closed
    assert client.controller.mode is RobotMode.IDLE


@BOTH
def test_a_message_may_come_in_pieces(robot: FrankaRobot) -> None:
    client = Client(FrankaController(robot))
    data = HEADER.pack(0, 7, 16) + struct.pack("<HH", robot.version, 4000)
    answers = b"".join(client.session.receive(data[at : at + 1]) for at in range(len(data)))
    assert answers == HEADER.pack(0, 7, 15) + struct.pack("<BH", 0, robot.version)


# -- motion


@BOTH
def test_the_joints_follow_with_the_lag_of_their_impedance(robot: FrankaRobot) -> None:
    for stiffness, factor in ((STIFFNESS, 1.0), (tuple(k / 2.0 for k in STIFFNESS), 2.0)):
        client = connected(robot)
        body = struct.pack("<7d", *stiffness)
        assert client.ask("set_joint_impedance", body) == "success"
        client.move()
        for command in ramp(robot, 100):
            client.step(command)
        motion = client.controller.motion
        late = (motion.dq_d[0] - motion.dq[0]) / motion.ddq_d[0]  # at constant acceleration
        assert late == pytest.approx(factor * LAGS[0], abs=0.6 * DT)


@BOTH
def test_the_state_shows_the_set_point_of_the_last_command(robot: FrankaRobot) -> None:
    client = moving(robot)
    speeds = ramp(robot, 3)
    for command in speeds:
        client.step(command)
    state = client.state()
    assert state.number == client.controller.number
    assert state.values["dq_d"] == pytest.approx(speeds[-1], abs=1e-7)
    assert state.values["ddq_d"][0] == pytest.approx((speeds[-1][0] - speeds[-2][0]) / DT, rel=1e-5)
    assert state.values["q_d"][0] == pytest.approx(HOME[0] + DT * sum(s[0] for s in speeds))
    assert (state.mode, state.generator, state.controller) == (RobotMode.MOVE, 2, 0)


@BOTH
def test_a_second_motion_and_settings_are_refused_while_one_runs(robot: FrankaRobot) -> None:
    client = moving(robot)
    assert client.move() == "not_possible"
    load = struct.pack("<13d", 0.5, *(0.0,) * 12)
    assert client.ask("set_load", load) == "not_possible"
    assert client.ask("automatic_error_recovery") == "not_possible"
    assert client.controller.load[0] == 0.0


@BOTH
@pytest.mark.parametrize(
    ("generator", "controller", "named"),
    [
        (2, 0, "cartesian_position and joint_impedance"),
        (3, 1, "cartesian_velocity and cartesian_impedance"),
        (1, 2, "joint_velocity and torques"),
        (4, 2, "none and torques"),
        (9, 0, "generator 9"),
        (1, 7, "controller 7"),
    ],
)
def test_motions_that_are_not_emulated_are_refused_by_name(
    robot: FrankaRobot, generator: int, controller: int, named: str
) -> None:
    client = connected(robot)
    assert client.move(generator, controller) == "invalid_argument"
    assert client.state().mode == RobotMode.IDLE
    assert any(named in text for text in client.controller.messages), client.controller.messages


@BOTH
def test_stop_move_brakes_within_the_limits_and_preempts_the_motion(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    speed = client.controller.motion.dq_d[0]
    assert client.ask("stop_move") == "success"
    way = come_to_rest(client)
    assert client.answers == [("move", "preempted")]
    assert 0.0 < way < braking_way(robot, speed)
    assert client.ask("stop_move") == "not_possible"
    assert client.move() == "started"


# -- packets


@BOTH
def test_a_lost_packet_continues_the_acceleration(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    motion = client.controller.motion
    before, rate = list(motion.dq_d), list(motion.ddq_d)
    assert rate[0] == pytest.approx(0.5 * robot.acceleration[0])
    client.wait(3)
    assert motion.ddq_d == pytest.approx(rate)
    assert motion.dq_d[0] == pytest.approx(before[0] + 3 * DT * rate[0])
    assert client.state().success_rate == pytest.approx(0.97)


@BOTH
def test_twenty_lost_packets_are_borne_and_one_more_is_a_reflex(robot: FrankaRobot) -> None:
    assert MOST_LOST == 20
    client = moving(robot)
    client.wait(20)
    client.step()
    client.wait(20)
    assert client.controller.mode is RobotMode.MOVE
    client.wait(1)
    assert client.state().errors == LOST
    assert client.answers == [("move", "reflex")]


@BOTH
@pytest.mark.parametrize("age", [1, 5])
def test_a_command_that_comes_late_is_lost(robot: FrankaRobot, age: int) -> None:
    client = moving(robot)
    late = client.datagram()
    client.wait(age)
    client.controller.receive(late)
    client.wait(1)
    assert client.controller.active is not None
    assert client.controller.active.lost == age + 1
    assert client.controller.sent_late == 1


@BOTH
def test_a_command_of_the_future_or_of_another_size_is_lost(robot: FrankaRobot) -> None:
    client = moving(robot)
    good = client.datagram()
    for data in (good[:-1], good + b"\0", b"", struct.pack("<Q", 10**18) + good[8:]):
        client.controller.receive(data)
    client.wait(1)
    assert client.controller.active is not None
    assert client.controller.active.lost == 1


@BOTH
def test_a_command_that_comes_twice_counts_once(robot: FrankaRobot) -> None:
    client = moving(robot)
    command = client.datagram(ramp(robot, 1)[0])
    client.controller.receive(command)
    client.controller.receive(command)
    client.wait(1)
    assert client.controller.active is not None
    assert len(client.controller.active.outcomes) == 2  # with the first one of `moving`
    assert client.controller.sent_late == 0


@BOTH
def test_a_motion_without_a_first_command_ends(robot: FrankaRobot) -> None:
    client = connected(robot)
    client.move()
    client.wait(START_CYCLES)
    assert client.controller.mode is RobotMode.MOVE
    client.wait(1)
    assert client.state().errors == LOST


@BOTH
def test_a_client_that_leaves_stops_the_arm(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    speed = client.controller.motion.dq_d[0]
    client.controller.disconnect()
    assert 0.0 < come_to_rest(client) < braking_way(robot, speed)
    assert client.state().errors == LOST
    assert client.answers == []


# -- people and surroundings


@BOTH
def test_automatic_error_recovery_ends_a_reflex_and_nothing_moves(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    client.controller.reflex(Error.joint_reflex, "test")
    assert client.state().reflex == ["joint_reflex"]
    come_to_rest(client)
    assert client.move() == "not_possible"
    place = list(client.controller.motion.q)
    assert client.ask("automatic_error_recovery") == ""  # the answer comes later
    assert client.state().mode == RobotMode.AUTOMATIC_ERROR_RECOVERY
    client.wait(RECOVERY_CYCLES)
    assert client.answers == [("move", "reflex"), ("automatic_error_recovery", "success")]
    state = client.state()
    assert (state.mode, state.errors, state.reflex) == (RobotMode.IDLE, [], ["joint_reflex"])
    assert client.controller.motion.q == pytest.approx(place, abs=1e-6)
    assert client.ask("automatic_error_recovery") == "success"
    assert client.move() == "started"
    assert client.state().reflex == []


@BOTH
def test_beyond_a_position_limit_only_a_person_recovers(robot: FrankaRobot) -> None:
    client = connected(robot)
    client.controller.reflex(Error.joint_position_limits_violation, "test")
    motion = client.controller.motion
    motion.q[3] = motion.q_d[3] = robot.position_max[3] + 0.01
    assert client.ask("automatic_error_recovery") == "manual"
    assert client.controller.guide(True, REST)
    client.wait(1)
    assert motion.q[3] == robot.position_max[3]
    assert client.controller.guide(False, REST)
    assert client.state().mode == RobotMode.REFLEX
    assert client.ask("automatic_error_recovery") == ""


@BOTH
def test_the_user_stop_ends_the_motion_until_it_is_released(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    client.controller.user_stop(True)
    come_to_rest(client)
    assert client.answers == [("move", "emergency")]
    state = client.state()
    assert (state.mode, state.generator) == (RobotMode.USER_STOPPED, 0)
    assert client.move() == client.ask("automatic_error_recovery") == "not_possible"
    place = list(client.controller.motion.q)
    client.controller.user_stop(False)
    client.wait(100)
    assert client.state().mode == RobotMode.IDLE
    assert client.controller.motion.q == pytest.approx(place, abs=1e-6)


@BOTH
def test_a_reflex_outlasts_a_user_stop(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    client.controller.reflex(Error.joint_reflex, "test")
    client.controller.user_stop(True)
    client.controller.user_stop(False)
    assert client.state().mode == RobotMode.REFLEX


@BOTH
def test_a_hand_guides_an_arm_that_is_idle_only(robot: FrankaRobot) -> None:
    client = connected(robot)
    dq = [0.1, 0.0, -0.2, 0.0, 0.0, 0.0, 0.3]
    assert client.controller.guide(True, dq)
    client.wait(1000)
    state = client.state()
    assert state.mode == RobotMode.GUIDING
    assert np.array(state.values["q"]) - HOME == pytest.approx(dq, abs=1e-6)
    assert client.move() == "not_possible"
    client.controller.guide(True, [2.0, *REST[1:]])
    client.wait(2000)
    assert client.controller.motion.q[0] == robot.position_max[0]
    assert client.controller.guide(False, REST)
    assert client.controller.motion.at_rest
    assert client.move() == "started"
    assert not client.controller.guide(True, dq)


@BOTH
def test_a_push_beyond_the_threshold_is_a_collision(robot: FrankaRobot) -> None:
    client = connected(robot)
    thresholds = [*[20.0] * 28, *[20.0] * 12, *[5.0] * 6, *[8.0] * 6]
    assert client.ask("set_collision_behavior", struct.pack("<52d", *thresholds)) == "success"
    client.move()
    client.step()
    client.controller.push([0.0, 0.0, -7.0, 0.0, 0.0, 0.0])
    client.step()
    state = client.state()
    assert state.errors == []
    assert state.values["cartesian_contact"] == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert state.values["O_F_ext_hat_K"][2] == -7.0
    client.controller.push([0.0, 0.0, -9.0, 0.0, 0.0, 0.0])
    client.step()
    state = client.state()
    assert state.errors == ["cartesian_reflex"]
    assert state.values["cartesian_collision"] == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@BOTH
def test_closed_brakes_hold_the_arm_until_they_are_released(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    client.controller.brakes(released=False)
    come_to_rest(client)
    assert client.state().mode == RobotMode.OTHER
    assert client.move() == "not_possible"
    client.controller.brakes(released=True)
    client.wait(UNLOCK_CYCLES)
    assert client.move() == "started"


# -- settings


@BOTH
def test_frames_and_load_are_shown_and_shift_the_end_effector(robot: FrankaRobot) -> None:
    client = connected(robot)
    flange = from_columns(client.state().values["O_T_EE"])
    pose = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.01, 0.02, 0.1, 1.0]
    assert client.ask("set_ne_to_ee", struct.pack("<16d", *pose)) == "success"
    load = [0.5, 0.01, 0.02, 0.03, *np.eye(3).ravel()]
    assert client.ask("set_load", struct.pack("<13d", *load)) == "success"
    values = client.state().values
    assert values["F_T_EE"] == values["NE_T_EE"] == pytest.approx(pose)
    assert from_columns(values["O_T_EE"]) == pytest.approx(flange @ from_columns(pose), abs=1e-6)
    assert (values["m_load"], values["F_x_Cload"]) == (
        pytest.approx((0.5,)),
        pytest.approx((0.01, 0.02, 0.03)),
    )


@BOTH
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("set_ne_to_ee", [2.0] * 16),
        ("set_ee_to_k", [float("nan")] * 16),
        ("set_load", [-0.1, *[0.0] * 12]),
        ("set_joint_impedance", [1e6] * 7),
        ("set_cartesian_impedance", [-1.0] * 6),
        ("set_collision_behavior", [0.0] * 52),
    ],
)
def test_settings_that_cannot_be_are_refused(
    robot: FrankaRobot, name: str, values: list[float]
) -> None:
    client = connected(robot)
    assert client.ask(name, struct.pack(f"<{len(values)}d", *values)) in (
        "invalid",
        "invalid_argument",
    )
    assert client.state().values["NE_T_EE"] == tuple(float(k % 5 == 0) for k in range(16))


def test_an_fer_has_no_model_library_and_an_fr3_has_a_model() -> None:
    client = connected(FER)
    assert client.ask("load_model_library", b"\0\0") == "error"
    assert "libfcimodels" in client.controller.messages[-1]
    fr3 = connected(FR3)
    code = {name: code for code, name in fr3.protocol.commands.items()}["get_robot_model"]
    answer = fr3.session.receive(HEADER.pack(code, 3, HEADER.size))
    assert HEADER.unpack_from(answer) == (code, 3, len(answer))
    assert answer[12] == 0
    text = answer[13:].decode()
    assert text.count("<position_based_velocity_limits") == 7


@BOTH
@pytest.mark.parametrize(("command", "size"), [(1, 12), (1, 30), (4, 20), (77, 12), (2, 4), (2, 0)])
def test_a_broken_message_closes_the_connection(
    robot: FrankaRobot, command: int, size: int
) -> None:
    client = connected(robot)
    assert client.session.receive(HEADER.pack(command, 1, size).ljust(size, b"\0")) == b""
    assert client.session.closed
    assert "connection closed" in client.controller.messages[-1]


@BOTH
def test_a_reboot_forgets_settings_and_closes_the_brakes(robot: FrankaRobot) -> None:
    client = at_speed(robot)
    client.controller.boot()
    client.wait(1)
    state = client.state()
    assert (state.mode, state.generator, state.errors) == (RobotMode.OTHER, 0, [])
    assert client.controller.motion.at_rest
