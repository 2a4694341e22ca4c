"""Rotation and pose helpers against scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_core import transforms


def test_rpy_is_urdfs() -> None:
    rng = np.random.default_rng(1)
    for rpy in rng.uniform(-math.pi, math.pi, (500, 3)):
        # scipy: lower case letters are turns about fixed axes, in order.
        expected = Rotation.from_euler("xyz", rpy).as_matrix()
        np.testing.assert_allclose(transforms.rpy_to_matrix(rpy), expected, atol=1e-14)


def test_axis_angle_is_scipys() -> None:
    rng = np.random.default_rng(2)
    for _ in range(500):
        axis, angle = rng.normal(size=3), float(rng.uniform(-7, 7))
        expected = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()
        np.testing.assert_allclose(
            transforms.axis_angle_to_matrix(axis, angle), expected, atol=1e-14
        )
    with pytest.raises(ValueError, match="length zero"):
        transforms.axis_angle_to_matrix([0, 0, 0], 1.0)


def test_quaternion_to_matrix_is_scipys_and_needs_no_unit_length() -> None:
    rng = np.random.default_rng(3)
    for q in rng.normal(size=(500, 4)):
        expected = Rotation.from_quat(q).as_matrix()
        np.testing.assert_allclose(transforms.quaternion_xyzw_to_matrix(q), expected, atol=1e-14)


def test_matrix_to_quaternion_and_back_is_exact_everywhere() -> None:
    """Random rotations, and the half turns where naive formulas divide by zero."""
    rng = np.random.default_rng(4)
    rotations = list(Rotation.random(500, random_state=5).as_matrix())
    rotations += [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for axis in rng.normal(size=(200, 3)):
        axis /= np.linalg.norm(axis)
        for angle in (math.pi, math.pi - 1e-9, math.pi + 1e-7, 1e-9):
            rotations.append(Rotation.from_rotvec(axis * angle).as_matrix())
    for R in rotations:
        q = transforms.matrix_to_quaternion_xyzw(R)
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
        assert q[3] >= 0
        np.testing.assert_allclose(transforms.quaternion_xyzw_to_matrix(q), R, atol=1e-14)


@pytest.mark.parametrize(
    "call",
    [
        lambda: transforms.rpy_to_matrix([0, 0]),
        lambda: transforms.quaternion_xyzw_to_matrix([0, 0, 0, 0]),
        lambda: transforms.quaternion_xyzw_to_matrix([0, 0, math.nan, 1]),
        lambda: transforms.matrix_to_quaternion_xyzw(np.eye(4)),
        lambda: transforms.matrix_to_quaternion_xyzw(np.diag([1.0, 1.0, -1.0])),
        lambda: transforms.matrix_to_quaternion_xyzw(2 * np.eye(3)),
        lambda: transforms.matrix_to_quaternion_xyzw(np.full((3, 3), math.nan)),
        lambda: transforms.make_pose([0, 0]),
        lambda: transforms.make_pose([0, 0, 0], np.zeros(5)),
        lambda: transforms.inverse_pose(np.eye(3)),
    ],
)
def test_wrong_shapes_and_values_are_refused(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError):
        call()


def test_poses_compose_and_invert() -> None:
    rpy = (0.1, -0.2, 0.3)
    R = transforms.rpy_to_matrix(rpy)
    q = transforms.matrix_to_quaternion_xyzw(R)
    X = transforms.make_pose([1, 2, 3], rpy)
    np.testing.assert_array_equal(X, transforms.make_pose([1, 2, 3], R))
    np.testing.assert_allclose(X, transforms.make_pose([1, 2, 3], q), atol=1e-15)
    np.testing.assert_array_equal(transforms.make_pose(), np.eye(4))
    np.testing.assert_allclose(X @ transforms.inverse_pose(X), np.eye(4), atol=1e-15)
    assert X.flags.c_contiguous
    assert X.dtype == np.float64
