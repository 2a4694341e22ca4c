"""Action spaces: what is encoded comes back, and means what the transforms say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_core import WristGeometry, action_space
from surg_core.action_space import ActionSpace
from surg_core.contract import ACTION_SPACES, ARM_ACTION, WRISTED_ACTION_SPACES
from surg_core.transforms import virtual_joints

ARMS = ("PSM1", "PSM2")
PERIOD = 0.05
WRIST = WristGeometry(0.0091, 0.0102, 0.4)


def commands(rows: int = 40) -> np.ndarray:
    """(rows, 10) a random walk of two arms in the workspace."""
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(0, [1e-3] * 3 + [0.02, 0.05], (rows, 2, 5)), axis=0)
    start = np.array([0.01, -0.02, 0.12, 0.3, 0.5])
    return (walk + start).reshape(rows, 10)


@pytest.mark.parametrize("name", ACTION_SPACES)
def test_what_is_encoded_comes_back(name: str) -> None:
    space, series = ActionSpace(name), commands()
    targets, before = series[1:], series[:-1]
    rows = space.encode(targets, before, PERIOD)
    np.testing.assert_allclose(space.decode(rows, before[0], PERIOD), targets, atol=1e-12)
    np.testing.assert_array_equal(rows.reshape(-1, 2, 5)[..., 4], targets.reshape(-1, 2, 5)[..., 4])
    assert len(space.columns(ARMS)) == len(space.units(ARMS)) == 10
    assert action_space.of_columns(space.columns(ARMS), ARMS) == space


def test_the_numbers_mean_what_their_names_say() -> None:
    series = commands()
    targets, before = series[1:], series[:-1]
    change = (targets - before).reshape(-1, 2, 5)[..., :4]
    relative = ActionSpace("relative").encode(targets, before, PERIOD).reshape(-1, 2, 5)
    np.testing.assert_allclose(relative[..., :4], change, atol=1e-15)
    velocity = ActionSpace("velocity").encode(targets, before, PERIOD).reshape(-1, 2, 5)
    np.testing.assert_allclose(velocity[..., :4] * PERIOD, change, atol=1e-15)
    joint = ActionSpace("joint").encode(targets, before, PERIOD).reshape(-1, 2, 5)
    for row, target in zip(joint[:, 1], targets.reshape(-1, 2, 5)[:, 1], strict=True):
        np.testing.assert_allclose(row[:4], virtual_joints(target[:3], target[3]), atol=1e-12)


def test_other_columns_are_no_action_space() -> None:
    assert ActionSpace().columns(["A"]) == tuple(f"A/{name}" for name in ARM_ACTION)
    assert action_space.of_columns(("PSM1/x", "PSM1/y"), ["PSM1"]) is None
    with pytest.raises(ValueError, match="'delta'; allowed: absolute, relative, velocity, joint"):
        ActionSpace("delta")


def with_a_wrist(rows: int = 40) -> np.ndarray:
    """(rows, 12) the same walk of a straight arm and of joints of a wristed one."""
    rng = np.random.default_rng(4)
    walk = np.cumsum(rng.normal(0, [1e-3] * 3 + [0.02, 0.03, 0.03, 0.05], (rows, 7)), axis=0)
    joints = walk + np.array([0.01, -0.02, 0.1, 3.0, 0.3, -0.4, 0.5])  # the roll passes pi
    return np.hstack([commands(rows)[:, :5], joints])


def tips(targets: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """Places and orientations of the wristed tip, written out anew."""
    centre, roll, pitch, yaw = targets[:, 5:8], *targets[:, 8:11].T
    s = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    axis = np.cross([0.0, 0.0, 1.0], s)
    angle = np.arccos(s[:, 2]) / np.linalg.norm(axis, axis=1)
    shaft = Rotation.from_rotvec(axis * angle[:, None]) * Rotation.from_euler("z", roll)
    turn = Rotation.from_euler("z", WRIST.turn)
    link = shaft * turn * Rotation.from_euler("y", pitch)
    tip = link * Rotation.from_euler("x", yaw) * turn.inv()
    along = np.array([0.0, 0.0, 1.0])
    p = centre + WRIST.pitch_to_yaw * link.apply(along) + WRIST.yaw_to_tip * tip.apply(along)
    return p, tip


@pytest.mark.parametrize("name", ACTION_SPACES)
def test_a_wrist_comes_back_beside_a_straight_arm(name: str) -> None:
    space, series = ActionSpace(name, (None, WRIST)), with_a_wrist()
    targets, before = series[1:], series[:-1]
    rows = space.encode(targets, before, PERIOD)
    np.testing.assert_allclose(space.decode(rows, before[0], PERIOD), targets, atol=1e-9)
    names = [f"PSM2/{column}" for column in WRISTED_ACTION_SPACES[name]]
    assert list(space.columns(ARMS)[5:]) == names
    assert rows.shape[1] == len(space.units(ARMS)) == 5 + len(names)
    assert action_space.of_columns(space.columns(ARMS), ARMS, (None, WRIST)) == space
    straight = ActionSpace(name).encode(targets[:, :5], before[:, :5], PERIOD)
    np.testing.assert_array_equal(rows[:, :5], straight)


def test_the_numbers_of_a_wrist_mean_what_their_names_say() -> None:
    series = with_a_wrist()
    targets, before = series[1:], series[:-1]

    def encoded(name: str) -> np.ndarray:
        return ActionSpace(name, (None, WRIST)).encode(targets, before, PERIOD)[:, 5:]

    (p, R), (p_before, R_before) = tips(targets), tips(before)
    absolute = encoded("absolute")
    np.testing.assert_allclose(absolute[:, :3], p, atol=1e-12)
    assert (Rotation.from_quat(absolute[:, 3:7]) * R.inv()).magnitude().max() < 1e-7
    assert np.sum(absolute[1:, 3:7] * absolute[:-1, 3:7], axis=1).min() > 0.9, "no sign flips"
    change = np.hstack([p - p_before, (R * R_before.inv()).as_rotvec()])
    np.testing.assert_allclose(encoded("relative")[:, :6], change, atol=1e-7)
    np.testing.assert_allclose(encoded("velocity")[:, :6], change / PERIOD, atol=1e-6)
    joint = encoded("joint")
    np.testing.assert_allclose(joint[:, 3:], targets[:, 8:], atol=1e-12)
    for row, target in zip(joint, targets, strict=True):
        np.testing.assert_allclose(row[:4], virtual_joints(target[5:8], target[8]), atol=1e-12)


def test_where_no_wrist_can_be_is_no_target() -> None:
    space, before = ActionSpace("absolute", (WRIST,)), with_a_wrist()[0, 5:]
    along = Rotation.from_euler("y", np.pi / 2) * Rotation.from_euler("z", -WRIST.turn)
    for q in (np.zeros(4), along.as_quat()):  # no rotation; the yaw axis points to the trocar
        p = 0.1 * np.array([0.0, 0.0, 1.0]) + WRIST.yaw_to_tip * along.apply([0.0, 0.0, 1.0])
        found = space.decode(np.array([[*p, *q, 0.3]]), before, PERIOD)
        assert np.isnan(found).all()
