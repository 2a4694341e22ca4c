"""check-frames takes the lens out of the places, and judges a calibrated cell at 8 degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surg_core import axis_angle_to_matrix
from surg_core.arm_view import Array
from surg_sim.appearance.lens import EndoscopeLens
from surg_teleop.frames.probe_moves import REST, STEPS, ProbeMove
from surg_teleop.frames.registration_verdict import (
    ANGLE,
    CALIBRATED_ANGLE,
    Lens,
    RegistrationOutcome,
    judge,
)
from surg_teleop.frames.tip_tracker import Place
from surg_teleop.frames.undistortion import EyeModel, straighten

K = np.array([[520.0, 0.0, 322.0], [0.0, 520.0, 236.0], [0.0, 0.0, 1.0]])
BASELINE = 0.004
BARREL = EndoscopeLens((-0.30, 0.08, 0.0005, -0.0005, 0.0))
TOE_IN = axis_angle_to_matrix(np.array([0.0, 1.0, 0.2]), 0.02)
"""R_LR of an endoscope whose eyes are not parallel."""


def pixel(p: Array, lens: EndoscopeLens | None) -> Array:
    """Pixel (2,) of a point (3,) before an eye, with or without a lens."""
    xy = p[:2] / p[2]
    return np.asarray(K[:2, :2] @ (xy if lens is None else lens.bend(xy)) + K[:2, 2])


def places(R: Array, lens: EndoscopeLens | None, R_LR: Array) -> dict[ProbeMove, Place]:
    """Places of the tip where the hand's axes are turned by R (3, 3) against the picture's."""
    found = {}
    for step in STEPS:
        p_L = np.array([0.006, -0.004, 0.08]) + R @ step.offset()
        p_R = R_LR.T @ (p_L - [BASELINE, 0.0, 0.0])
        left = pixel(p_L, lens)
        found[step] = Place(left, left - pixel(p_R, lens))
    return found


def eyes(lens: EndoscopeLens, R_LR: Array) -> tuple[EyeModel, EyeModel]:
    """What camera_info states of both."""
    left = EyeModel(K, np.array(lens.distortion), "plumb_bob", np.eye(3))
    return left, replace(left, R=R_LR)


def test_a_lens_and_a_squint_are_taken_out() -> None:
    expected = places(np.eye(3), None, np.eye(3))
    found = straighten(places(np.eye(3), BARREL, TOE_IN), *eyes(BARREL, TOE_IN))
    for step in STEPS:
        assert np.abs(found[step].left - expected[step].left).max() < 0.01
        away = np.asarray(found[step].disparity) - np.asarray(expected[step].disparity)
        assert np.abs(away).max() < 0.02


def test_parallel_pinholes_stay_as_they_are() -> None:
    before = places(np.eye(3), None, np.eye(3))
    assert straighten(before, *eyes(EndoscopeLens(), np.eye(3))) == before


def test_one_eye_is_straightened_without_a_disparity() -> None:
    flat = {
        step: replace(each, disparity=None)
        for step, each in places(np.eye(3), BARREL, np.eye(3)).items()
    }
    found = straighten(flat, eyes(BARREL, np.eye(3))[0], None)
    assert found[REST].disparity is None


@pytest.mark.parametrize(
    ("degrees", "usual", "calibrated"),
    [(5.0, True, True), (12.0, True, False), (25.0, False, False)],
)
def test_a_calibrated_cell_is_judged_at_eight_degrees(
    degrees: float, usual: bool, calibrated: bool
) -> None:
    R = axis_angle_to_matrix(np.array([0.5, 1.0, 0.3]), np.radians(degrees))
    straight = straighten(places(R, BARREL, TOE_IN), *eyes(BARREL, TOE_IN))
    lens = Lens(K[0, 0], K[:2, 2], BASELINE)
    for limit, passes in ((ANGLE, usual), (CALIBRATED_ANGLE, calibrated)):
        verdict = judge(straight, lens, limit)
        assert (verdict.outcome is RegistrationOutcome.PASS) == passes
        assert abs(np.degrees(verdict.angle) - degrees) < 3.0
