"""Rotation and pose helpers against scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from conftest import FULL
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


FAMILIES = 2000 if FULL else 40


def test_minimal_rotation_takes_one_axis_to_another_by_the_shortest_way() -> None:
    rng = np.random.default_rng(11)
    for a, b in rng.normal(size=(FAMILIES, 2, 3)):
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        R = transforms.minimal_rotation(a, b)
        np.testing.assert_allclose(R @ a, b, atol=1e-12)
        shortest = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        assert Rotation.from_matrix(R).magnitude() == pytest.approx(shortest, abs=1e-7)


def test_virtual_joints_turn_the_axis_about_y_then_about_minus_x() -> None:
    """The definition by scipy: yaw about y, then pitch about the turned -x."""
    rng = np.random.default_rng(12)
    yaw, pitch, insertion = rng.uniform(-1.5, 1.5, (3, FAMILIES))
    turns = Rotation.from_euler("YX", np.column_stack([yaw, -pitch]))
    expected = turns.apply([0.0, 0.0, 1.0]) * insertion[:, None]
    found = transforms.virtual_tip(yaw, pitch, insertion)
    np.testing.assert_allclose(found, expected, atol=1e-14)
    back = transforms.virtual_joints(found[0], 0.3)
    joints = np.array([yaw[0], pitch[0], insertion[0], 0.3])
    np.testing.assert_allclose(transforms.virtual_tip(*back[:3]), found[0], atol=1e-14)
    assert insertion[0] < 0.0 or back == pytest.approx(joints)
    one = transforms.virtual_tip(yaw[0], pitch[0], insertion[0])
    np.testing.assert_array_equal(one, found[0])


def test_the_twist_is_what_was_put_in_whatever_the_swing() -> None:
    rng = np.random.default_rng(13)
    twist = rng.uniform(-math.pi, math.pi, FAMILIES)
    swing = rng.uniform(-1.8, 1.8, (FAMILIES, 3)) * [1.0, 1.0, 0.0]
    turns = Rotation.from_rotvec(swing) * Rotation.from_rotvec(np.outer(twist, [0, 0, 1]))
    found, quality = transforms.twist_angle(turns.as_matrix())
    np.testing.assert_allclose(found, twist, atol=1e-9)
    np.testing.assert_allclose(
        quality, np.abs(np.cos(np.linalg.norm(swing, axis=1) / 2)), atol=1e-12
    )
    assert transforms.twist_angle(np.diag([1.0, -1.0, -1.0]))[1] == 0.0, "half a turn of swing"


def test_rows_multiply_and_rotate_as_scipy_does() -> None:
    rng = np.random.default_rng(14)
    a, b = Rotation.random(FAMILIES, random_state=1), Rotation.random(FAMILIES, random_state=2)
    v = rng.normal(size=(FAMILIES, 3))
    product = transforms.multiply_quaternions(a.as_quat(), b.as_quat())
    assert (Rotation.from_quat(product).inv() * (a * b)).magnitude().max() < 1e-7
    turned = transforms.rotate(a.as_quat(), v)
    np.testing.assert_allclose(turned, a.apply(v), atol=1e-12)
    np.testing.assert_allclose(transforms.rotate_back(a.as_quat(), turned), v, atol=1e-12)


def test_tool_orientations_are_those_of_single_poses() -> None:
    rng = np.random.default_rng(15)
    p = rng.normal(size=(FAMILIES, 3))
    p[:, 2] = np.abs(p[:, 2])  # into the patient
    roll = rng.uniform(-4, 4, FAMILIES)
    s = p / np.linalg.norm(p, axis=1, keepdims=True)
    found = transforms.tip_quaternions(s, roll)
    one_by_one = [transforms.tip_quaternion(*each) for each in zip(p, roll, strict=True)]
    np.testing.assert_allclose(found, one_by_one, atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(found).apply([0, 0, 1]), s, atol=1e-12)


def test_slerp_is_scipys_whatever_the_signs() -> None:
    rng = np.random.default_rng(16)
    a, b = Rotation.random(FAMILIES, random_state=3), Rotation.random(FAMILIES, random_state=4)
    part, sign = rng.uniform(size=FAMILIES), rng.choice([-1.0, 1.0], (FAMILIES, 1))
    found = transforms.slerp(a.as_quat(), sign * b.as_quat(), part)
    for i in range(FAMILIES):
        expected = Slerp([0.0, 1.0], Rotation.concatenate([a[i], b[i]]))(part[i])
        assert (Rotation.from_quat(found[i]).inv() * expected).magnitude() < 1e-7
    same = transforms.slerp(a.as_quat(), a.as_quat(), part)
    np.testing.assert_allclose(same, a.as_quat(), atol=1e-15)


def test_continuous_quaternions_are_the_same_rotations() -> None:
    turns = Rotation.random(50, random_state=3).as_quat()
    found = transforms.continuous_quaternions(turns)
    np.testing.assert_allclose(np.abs(np.sum(found * turns, axis=1)), 1.0)
    assert found[0, 3] >= 0.0
    assert (np.sum(found[1:] * found[:-1], axis=1) >= 0.0).all()
    assert transforms.continuous_quaternions(turns[:0]).shape == (0, 4)
