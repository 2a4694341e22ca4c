"""What the hand may feel of the tip: in the view's axes, only while the arm follows it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from surg_teleop.follow.force_feedback import ForceFeedback

RNG = np.random.default_rng(3)


def test_the_force_is_that_of_the_picture() -> None:
    """However base and camera stand: a force that pushes along an axis of the view says so."""
    for R_WB, R_WV in zip(Rotation.random(50, 1), Rotation.random(50, 2), strict=True):
        felt, f_V = ForceFeedback(), RNG.normal(size=3)
        assert not felt.follow(True, R_WB.as_matrix(), R_WV.as_matrix())
        told = felt.take(1, R_WB.inv().apply(R_WV.apply(f_V)))
        assert told is not None
        np.testing.assert_allclose(told, f_V, atol=1e-12)


def test_nothing_is_felt_unless_the_arm_follows() -> None:
    felt, one, nan = ForceFeedback(), np.ones(3), np.full((3, 3), np.nan)
    assert felt.take(1, one) is None
    for R_WV in (None, nan):
        felt.follow(True, np.eye(3), np.eye(3))
        assert felt.follow(True, np.eye(3), R_WV), "the hand is told at once"
        assert felt.take(1, one) is None
    felt.follow(True, np.eye(3), np.eye(3))
    assert felt.take(1, one) is not None
    assert felt.take(0, one) is None, "the sensor does not know"
    assert felt.take(1, np.array([0.0, np.nan, 0.0])) is None
    assert felt.follow(False, np.eye(3), np.eye(3)) and felt.take(1, one) is None
    assert not felt.follow(False, np.eye(3), np.eye(3)), "told once"
