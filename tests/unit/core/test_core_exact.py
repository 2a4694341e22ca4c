"""The exact form through the binding: against numpy, and against what the arrays must not allow."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

import surg_core
from surg_core import _core, testing

S_F = np.array([0.0, 0.0, 1.0])
P_FTIP = np.array([0.06, 0.0, 0.3])
UR5E_HOME = np.array([-0.294, -1.234, 1.511, -1.29, -1.63, -2.134])
PANDA_HOME = np.array([-0.147, -0.437, -0.073, -2.227, 0.367, 1.791, 0.044])


def _place(x: float, y: float, z: float, roll: float) -> np.ndarray:
    c, s = math.cos(roll), math.sin(roll)
    X = np.eye(4)
    X[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    X[:3, 3] = [x, y, z]
    return X


def _chain(places: list[tuple[float, float, float, float]], end: np.ndarray) -> surg_core.Chain:
    joints = [_core.Joint(f"j{i}", _place(*at), [0, 0, 1]) for i, at in enumerate(places)]
    return surg_core.Chain(joints, end)


def _ur5e() -> surg_core.Chain:
    """Standard DH of the UR5e: joint i + 1 stands behind the DH transform i."""
    half = math.pi / 2
    return _chain(
        [
            (0, 0, 0, 0),
            (0, 0, 0.1625, half),
            (-0.425, 0, 0, 0),
            (-0.3922, 0, 0, 0),
            (0, 0, 0.1333, half),
            (0, 0, 0.0997, -half),
        ],
        _place(0, 0, 0.0996, 0),
    )


def _panda() -> surg_core.Chain:
    half = math.pi / 2
    return _chain(
        [
            (0, 0, 0.333, 0),
            (0, 0, 0, -half),
            (0, -0.316, 0, half),
            (0.0825, 0, 0, half),
            (-0.0825, 0.384, 0, -half),
            (0, 0, 0, half),
            (0.088, 0, 0, half),
        ],
        _place(0, 0, 0.107, 0),
    )


ARMS = [pytest.param(_ur5e(), UR5E_HOME, id="ur5e"), pytest.param(_panda(), PANDA_HOME, id="panda")]


class _Scene:
    """An arm at home, 120 mm of its shaft behind the trocar, and a circle for the tip."""

    def __init__(self, chain: surg_core.Chain, q: np.ndarray, n: int = 500) -> None:
        X_BF = chain.forward(q)
        self.home = testing.Home(X_BF, S_F, P_FTIP)
        tip = X_BF[:3, :3] @ P_FTIP + X_BF[:3, 3]
        self.p_BRcm = tip - 0.12 * self.home.s_B
        a = np.linspace(0, 2 * math.pi, n)
        circle = 0.03 * np.stack([np.sin(a), 1 - np.cos(a), 0.5 * np.sin(a)], axis=1)
        self.tips = tip + circle
        self.rolls = 0.5 * np.sin(a)
        self.poses = testing.poses_on_pivot(
            self.home, S_F, P_FTIP, self.p_BRcm, self.tips, self.rolls
        )


@pytest.mark.parametrize(("chain", "q"), ARMS)
def test_poses_lie_on_the_pivot_with_the_tip_as_asked(
    chain: surg_core.Chain, q: np.ndarray
) -> None:
    scene = _Scene(chain, q)
    R, p = scene.poses[:, :3, :3], scene.poses[:, :3, 3]
    tips = R @ P_FTIP + p
    np.testing.assert_allclose(tips, scene.tips, atol=1e-13)
    s = R @ S_F
    off = np.cross(tips - scene.p_BRcm, s)  # distance of the trocar from the shaft's line
    assert np.abs(off).max() < 1e-13
    single = testing.pose_on_pivot(
        scene.home,
        S_F,
        P_FTIP,
        testing.tip_goal(scene.p_BRcm, scene.tips[77], scene.rolls[77], scene.home.s_B),
    )
    np.testing.assert_array_equal(single, scene.poses[77])


@pytest.mark.parametrize(("chain", "q"), ARMS)
@pytest.mark.parametrize("closed_form", [False, True])
def test_joints_follow_the_poses(chain: surg_core.Chain, q: np.ndarray, closed_form: bool) -> None:
    scene = _Scene(chain, q, n=2000)
    stepper = testing.NextPose(chain, closed_form)
    assert stepper.closed_form == (closed_form and chain.dof == 6)
    joints, conditioning = stepper.follow(q, scene.poses, q_posture=q, pull=0.002)
    assert joints.shape == (2000, chain.dof)
    assert conditioning.min() > 0
    np.testing.assert_allclose(chain.forward_batch(joints), scene.poses, atol=1e-9)
    # The batch is the single steps one after the other.
    now = q
    for i in range(20):
        now = now + stepper.step(now, scene.poses[i], 0.002 * (q - now)).dq
        np.testing.assert_array_equal(now, joints[i])
    stages = testing.exact_step(chain, joints[5], scene.poses[6])
    np.testing.assert_allclose(chain.forward(joints[5] + stages.dq), scene.poses[6], atol=1e-9)


def test_spherical_goals_are_the_same_poses() -> None:
    chain, q = _ur5e(), UR5E_HOME
    scene = _Scene(chain, q)
    X_BR = surg_core.rcm_frame(scene.home.s_B, scene.p_BRcm)
    goal = testing.tip_goal(scene.p_BRcm, scene.tips[100], 0.2, scene.home.s_B)
    yaw, pitch = surg_core.shaft_angles(X_BR[:3, :3].T @ goal.s_B)
    same = testing.spherical_goal(X_BR, [yaw, pitch, goal.depth, goal.roll])
    np.testing.assert_allclose(same.p_BTip, scene.tips[100], atol=1e-13)
    outside = testing.ShaftGoal(scene.p_BRcm, scene.home.s_B, -0.01, 0.0)
    np.testing.assert_allclose(outside.p_BTip, scene.p_BRcm - 0.01 * scene.home.s_B)


def test_the_correction_puts_the_shaft_back() -> None:
    chain, q = _ur5e(), UR5E_HOME.copy()
    q[4] = 0.0  # a singular wrist is no obstacle
    X_BF = chain.forward(q)
    tip = X_BF[:3, :3] @ P_FTIP + X_BF[:3, 3]
    p_BRcm = tip - 0.12 * X_BF[:3, 2] + 1e-5 * X_BF[:3, 0]
    rows = testing.rcm_rows(chain.jacobian(q), surg_core.shaft_state(X_BF, S_F, P_FTIP, p_BRcm))
    dq = testing.rcm_correction(rows).dq
    np.testing.assert_allclose(dq, np.linalg.pinv(rows.J) @ rows.e, atol=1e-12)
    after = surg_core.shaft_state(chain.forward(q + dq), S_F, P_FTIP, p_BRcm)
    assert np.linalg.norm(after.e) < 1e-9


def test_all_postures_of_the_ur_reach_the_pose() -> None:
    chain = _ur5e()
    X_BF = chain.forward(UR5E_HOME)
    found = testing.UrInverse(chain).solve_all(X_BF, UR5E_HOME)
    assert len(found) == 8
    for one in found:
        np.testing.assert_allclose(chain.forward(one.q), X_BF, atol=1e-12)
    assert min(np.abs(one.q - UR5E_HOME).max() for one in found) < 1e-10
    with pytest.raises(ValueError, match="7 joints, not 6"):
        testing.UrInverse(_panda())


def test_the_follower_learns_the_lag() -> None:
    T, tau = 0.002, np.linspace(0.008, 0.013, 6)
    follower = testing.ExactFollower(6, lag=0.015, T=T)
    q, qd = np.zeros(6), np.zeros(6)
    follower.reset(q)
    references = []
    keep = np.exp(-T / tau)
    for i in range(10000):
        t = i * T
        rate = np.sin(np.arange(1, 7) * t)
        command = follower.advance(T * rate, q)
        references.append(np.array(follower.reference))
        q = q + T * command + tau * (1 - keep) * (qd - command)
        qd = command + keep * (qd - command)
    np.testing.assert_allclose(follower.lag, tau, atol=5e-4)
    # The arm is where the reference was the stated lag ago, in whole periods.
    assert np.abs(references[-9] - q).max() < 5e-4
    with pytest.raises(ValueError, match="joints: 1 to 8, not 9"):
        testing.ExactFollower(9, 0.01)
    with pytest.raises(ValueError, match="0 or more"):
        testing.ExactFollower(6, float("nan"))


def test_attributes_are_read_only() -> None:
    chain, q = _ur5e(), UR5E_HOME
    scene = _Scene(chain, q)
    goal = testing.tip_goal(scene.p_BRcm, scene.tips[0], 0.0, scene.home.s_B)
    step = testing.exact_step(chain, q, scene.poses[0])
    rows = testing.rcm_rows(
        chain.jacobian(q), surg_core.shaft_state(chain.forward(q), S_F, P_FTIP, scene.p_BRcm)
    )
    follower = testing.ExactFollower(6, 0.01)
    solution = testing.UrInverse(chain).solve_all(scene.poses[0], q)[0]
    for array in (
        scene.home.s_B,
        scene.home.R_BF,
        goal.p_BRcm,
        goal.s_B,
        goal.p_BTip,
        step.dq,
        rows.J,
        rows.e,
        follower.reference,
        follower.lag,
        solution.q,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_shapes_and_poses_are_checked() -> None:
    chain, q = _ur5e(), UR5E_HOME
    scene = _Scene(chain, q, n=4)
    stepper = testing.NextPose(chain)
    with pytest.raises(ValueError, match=r"q: shape \(m, 6\) is needed, not \(3, 7\)"):
        chain.forward_batch(np.zeros((3, 7)))
    with pytest.raises(ValueError, match=r"q: shape \(m, 6\) is needed"):
        chain.forward_batch(np.zeros(6))
    with pytest.raises(ValueError, match="roll"):
        testing.poses_on_pivot(scene.home, S_F, P_FTIP, scene.p_BRcm, scene.tips, [0.0])
    broken = scene.poses.copy()
    broken[2, 0, 0] = np.nan
    with pytest.raises(ValueError, match=r"X_BFGoals\[2\]: not a pose"):
        stepper.follow(q, broken)
    assert chain.forward_batch(np.zeros((0, 6))).shape == (0, 4, 4)


def test_batches_release_the_gil() -> None:
    chain = _ur5e()
    q = np.tile(UR5E_HOME, (400_000, 1))
    ticks = 0
    done = threading.Event()

    def count() -> None:
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(1e-4)

    thread = threading.Thread(target=count)
    thread.start()
    time.sleep(0.01)
    before = ticks
    chain.forward_batch(q)
    during = ticks - before
    done.set()
    thread.join()
    assert during >= 5  # with the GIL held it could not count at all
