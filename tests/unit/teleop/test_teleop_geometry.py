"""Roll of the handle and the nearest point of the workspace."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.teleop.hand import WORKSPACE
from surg_core.hand.leader_sample import HandlePose
from surg_teleop.follow.straight_target import Handle


def test_roll_is_the_twist_of_swing_and_twist() -> None:
    """Any swing times a known twist, against SciPy's quaternions."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        R_0 = Rotation.random(random_state=rng.integers(2**31))
        handle = Handle(HandlePose(np.zeros(3), R_0.as_quat()))
        turn = 0.0
        for _ in range(40):
            turn += rng.uniform(-0.4, 0.4)
            direction = rng.uniform(0.0, math.tau)
            swing = rng.uniform(0.0, 2.5)
            axis = [swing * math.cos(direction), swing * math.sin(direction), 0.0]
            R = R_0 * Rotation.from_rotvec(axis) * Rotation.from_euler("z", turn)
            handle.move(HandlePose(np.zeros(3), R.as_quat()))
            assert handle.roll == pytest.approx(turn, abs=1e-9)


def test_a_handle_that_points_back_keeps_its_roll() -> None:
    handle = Handle(HandlePose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    rolls = []
    for angle in np.arange(0.0, 2.0 * math.pi, 0.01):  # once head over heels
        R = Rotation.from_euler("x", angle)
        handle.move(HandlePose(np.zeros(3), R.as_quat()))
        rolls.append(handle.roll)
    assert np.abs(rolls).max() < 1e-9


def test_the_nearest_point_is_inside_and_near() -> None:
    rng = np.random.default_rng(11)
    inside = 0
    for _ in range(3000):
        p = rng.normal(0.0, 0.12, 3)
        q, wall = WORKSPACE.nearest(p)
        depth = np.linalg.norm(q)
        assert 0.030 <= depth <= 0.220
        assert q[2] >= depth * math.cos(1.0472)
        assert (wall == "") == np.array_equal(p, q)
        inside += wall == ""
        again, held = WORKSPACE.nearest(q)
        assert again == pytest.approx(q, abs=1e-12)
        assert held == "" or wall != ""
    print(f"{inside} of 3000 inside")
    assert 100 < inside < 2900
