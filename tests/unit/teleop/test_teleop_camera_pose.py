"""The camera pose that maps the hand while the endoscope moves."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import Hand, settings
from surg_teleop.follow.teleop_types import CameraView
from surg_teleop.follow.teleoperation import Teleop


def test_a_moving_endoscope_is_applied_exactly_once() -> None:
    """The scope rolls and swings while the hand moves right: the tip moves right in each picture.

    Mapped not at all, or twice, the same run is wrong by more than a third of its way.
    """
    arm, hand = GateArm(), Hand()
    arm.R_WR = Rotation.from_rotvec([0.3, 0.8, -0.4]).as_matrix()
    teleop = Teleop(settings(), scale=1.0)
    teleop.enable()
    right = np.array([1e-4, 0.0, 0.0])
    errors: dict[int, float] = {0: 0.0, 1: 0.0, 2: 0.0}
    for k in range(400):
        now = arm.tick * TICK
        R_WV = Rotation.from_euler("zyx", [0.01 * k, 0.3 * math.sin(0.02 * k), 0.4]).as_matrix()
        if k > 5:
            hand.move(right)
        out = teleop.tick(now, hand.sample(now), arm.view(), CameraView(R_WV))
        before = arm.p
        arm.step(out.commands)
        if k <= 10:
            continue
        moved = arm.p - before
        R_RV = arm.R_WR.T @ R_WV
        for times in errors:
            expected = np.linalg.matrix_power(R_RV, times) @ right
            errors[times] = max(errors[times], float(np.linalg.norm(moved - expected)))
    assert errors[1] < 1e-12
    assert errors[0] > 0.3e-4
    assert errors[2] > 0.3e-4
