"""The emulated arm's kinematics and motion against formulas and finite differences."""

import itertools
import math
import os

import numpy as np
import pytest

from helpers.hardware.emulated_ur import cycle, settle
from surg_cli.host import paths
from surg_core.urdf import chain_from_urdf, read_joints
from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import (
    DT,
    LAGS,
    MAX_ACCELERATION,
    MAX_SPEED,
    JointMotion,
    Move,
    Servo,
    Speed,
)
from surg_emulators.ur.ur_controller import HOME, UrController

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
POSTURES = 5_000 if FULL else 200
CYCLES = 1_000_000 if FULL else 30_000
URDF = paths.ROOT / "src/surg_description/urdf"
TURNED = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From UR's base to ROS's base_link."""


def postures(seed: int, count: int = POSTURES) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, 6))


@pytest.mark.parametrize("model", dh.TABLES)
def test_kinematics_agree_with_the_urdf(model: str) -> None:
    urdf = URDF / f"{model.lower()}.urdf"
    names = [j.name for j in read_joints(urdf, "base_link", "flange") if j.turning]
    chain = chain_from_urdf(urdf, "base_link", "flange", names)
    worst = 0.0
    for q in postures(1):
        ours = TURNED @ dh.frames(q, dh.TABLES[model])[-1]
        theirs = np.asarray(chain.forward(q))
        worst = max(worst, float(np.abs(ours[:3, 3] - theirs[:3, 3]).max()))
        # The URDF's flange frame may be turned about fixed axes, but not by the joints.
        if q is not None:
            fixed = ours[:3, :3].T @ theirs[:3, :3]
            assert np.allclose(fixed, np.round(fixed), atol=1e-5)
    print(f"{model}: {POSTURES} postures, {1e6 * worst:.2f} um")
    assert worst < 1e-6


def test_jacobian_agrees_with_finite_differences() -> None:
    table, step = dh.TABLES["UR5e"], 1e-6
    X_FTcp = dh.pose_matrix([0.01, -0.02, 0.15, 0.3, -0.2, 0.1])
    worst = 0.0
    for q in postures(2, 100):
        J = dh.jacobian(q, table, X_FTcp)
        for joint in range(6):
            ahead, behind = q.copy(), q.copy()
            ahead[joint] += step
            behind[joint] -= step
            A = dh.frames(ahead, table)[-1] @ X_FTcp
            B = dh.frames(behind, table)[-1] @ X_FTcp
            rate = np.r_[A[:3, 3] - B[:3, 3], dh.rotation_vector(A[:3, :3] @ B[:3, :3].T)]
            worst = max(worst, float(np.abs(J[:, joint] - rate / (2.0 * step)).max()))
    assert worst < 1e-8


def test_rotation_vectors_are_inverted_up_to_half_a_turn() -> None:
    generator = np.random.default_rng(3)
    angles = (0.0, 1e-9, 1e-5, 1.0, math.pi - 1e-5, math.pi - 1e-9, math.pi)
    for angle, _ in itertools.product(angles, range(20)):
        axis = generator.normal(size=3)
        R = dh.rotation_matrix(angle * axis / np.linalg.norm(axis))
        again = dh.rotation_matrix(dh.rotation_vector(R))
        assert np.abs(again - R).max() < 1e-7, (angle, axis)


def test_inverse_kinematics_give_the_pose_again() -> None:
    table, X_FTcp = dh.TABLES["UR5e"], dh.pose_matrix([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    for offset in postures(4, 20):
        q = np.array(HOME) + 0.1 * offset
        X = dh.frames(q, table)[-1] @ X_FTcp
        found = dh.inverse(X, HOME, table, X_FTcp)
        assert found is not None
        assert np.abs(dh.frames(found, table)[-1] @ X_FTcp - X).max() < 1e-8
    far = np.eye(4)
    far[0, 3] = 5.0
    assert dh.inverse(far, HOME, table, X_FTcp) is None


def test_speed_ramps_with_the_acceleration_of_the_leading_axis() -> None:
    motion, wanted = JointMotion([0.0] * 6), [0.4, -0.2, 0.1, 0.0, 0.3, -0.05]
    motion.command = Speed(wanted, 10.0)
    for step in range(1, 41):
        assert motion.step() == ""
        share = min(1.0, 10.0 * DT * step / 0.4)
        assert motion.qd == pytest.approx([share * rate for rate in wanted], abs=1e-12)
    for _ in range(1000):  # it goes on until another command comes
        motion.step()
    assert motion.qd == pytest.approx(wanted)


def test_every_joint_has_its_own_lag() -> None:
    motion = JointMotion([0.0] * 6)
    motion.command = Speed([0.5] * 6, 40.0)
    for _ in range(500):
        motion.step()
    late = [(goal - q) / 0.5 for goal, q in zip(motion.q, motion.actual_q, strict=True)]
    # A sampled first-order lag: exact to half a cycle.
    assert late == pytest.approx(LAGS, abs=DT / 2.0)
    assert min(LAGS) >= 0.005 and max(LAGS) <= 0.0085
    assert len(set(LAGS)) == 6


@pytest.mark.parametrize(("a", "v"), [(1.0, 10.0), (2.0, 0.5), (40.0, 1.0)])
def test_a_move_takes_the_time_of_its_trapezoid(a: float, v: float) -> None:
    motion, goal = JointMotion([0.0] * 6), [0.6, -0.3, 0.1, 0.0, 0.2, -0.6]
    motion.command = Move(goal, a, v)
    top = min(v, math.sqrt(a * 0.6))
    expected = 0.6 / top + top / a
    cycles = 0
    while max(abs(g - q) for g, q in zip(goal, motion.q, strict=True)) > 1e-9:
        assert motion.step() == ""
        cycles += 1
        assert max(map(abs, motion.qd)) <= v + 1e-9
        assert max(map(abs, motion.qdd)) <= a + 1e-6
        assert cycles < 5000
    assert expected - DT <= cycles * DT <= 1.1 * expected + 3 * DT


def test_a_servo_follows_a_ramp_with_its_look_ahead() -> None:
    motion = JointMotion([0.0] * 6)
    for step in range(1000):
        motion.command = Servo([0.2 * step * DT] * 6, 0.05)
        assert motion.step() == ""
    assert (0.2 * 999 * DT - motion.q[0]) / 0.2 == pytest.approx(0.05, abs=0.002)


def test_random_commands_never_exceed_the_limits() -> None:
    generator = np.random.default_rng(5)
    motion, stops = JointMotion(list(HOME)), 0
    for step in range(CYCLES):
        if step % 7 == 0:
            qd = generator.uniform(-3.5, 3.5, 6)
            goal = np.array(HOME) + generator.uniform(-1.0, 1.0, 6)
            a = float(generator.uniform(1.0, 60.0))
            kind = generator.integers(3)
            motion.command = [Speed(list(qd), a), Move(list(goal), a, 3.0), Servo(goal, 0.1)][kind]
            motion.scale = motion.scale if step else 1.0
        if motion.step():
            stops += 1
            motion.brake()
            motion.step()
        assert max(map(abs, motion.qd)) <= MAX_SPEED
        assert max(map(abs, motion.qdd)) <= MAX_ACCELERATION
    print(f"{CYCLES} cycles, {stops} stops")
    assert 0 < stops < CYCLES


def test_tcp_pose_and_speed_follow_the_offset() -> None:
    controller = UrController()
    flange = controller.tcp_pose(controller.motion.actual_q)
    controller.tcp_offset = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    tool = controller.tcp_pose(controller.motion.actual_q)
    assert math.dist(flange[:3], tool[:3]) == pytest.approx(0.1)
    before = np.array(tool)
    qd = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    controller.guide(True, qd)
    settle(controller, 0.01)
    speed = controller.tcp_speed(controller.motion.actual_q, qd)
    moved = np.array(controller.tcp_pose(controller.motion.actual_q)) - before
    assert moved[:3] / 0.01 == pytest.approx(speed[:3], abs=1e-3)


def test_a_calibrated_arm_stands_elsewhere() -> None:
    errors = [(0.001, 0.0, 0.0), *[(0.0, 0.0, 0.0)] * 5]
    plain, calibrated = UrController(), UrController(dh_errors=errors)
    difference = np.array(calibrated.tcp_pose(HOME)) - np.array(plain.tcp_pose(HOME))
    assert difference == pytest.approx([0.0, 0.0, 0.001, 0.0, 0.0, 0.0], abs=1e-9)
    cycle(calibrated)
