"""Which arm is at the address: serial, model, payload, and the flange by an independent formula."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surg_hardware import identity
from surg_hardware.robot_adapter import ArmIdentity

CELL = ArmIdentity("ur5e", (), "20225500123", 0.85, (0.0, 0.02, 0.11))


def found(**changed: Any) -> ArmIdentity:
    return replace(CELL, **{"model": "UR5", **changed})


def test_the_arm_of_the_cell_is_accepted() -> None:
    assert identity.mismatches(CELL, found()) == []
    assert identity.mismatches(CELL, found(model="UR5e", mass=0.94, cog=(0, 0.02, 0.1299))) == []


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"serial": "20225500124"}, "hardware.serial"),
        ({"serial": ""}, "hardware.serial"),
        ({"model": "UR10"}, "robot"),
        ({"model": ""}, "robot"),
        ({"mass": 0.96}, "hardware.payload.mass"),
        ({"mass": math.nan}, "hardware.payload.mass"),
        ({"cog": (0.0, 0.02, 0.131)}, "hardware.payload.cog"),
    ],
)
def test_another_arm_is_refused_by_the_cells_key(changed: dict[str, Any], key: str) -> None:
    (mismatch,) = identity.mismatches(CELL, found(**changed))
    assert mismatch.what == key and mismatch.cure


def rotation(axis: int, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def test_a_flange_may_differ_by_half_a_millimetre_and_a_tenth_of_a_degree() -> None:
    ours = np.eye(4)
    for axis in range(3):
        for size, wrong in ((0.9, False), (1.1, True)):
            moved, turned = np.eye(4), np.eye(4)
            moved[axis, 3] = size * 0.0005
            turned[:3, :3] = rotation(axis, size * math.radians(0.1))
            assert bool(identity.flange_mismatch(ours, moved)) == wrong
            assert bool(identity.flange_mismatch(ours, turned)) == wrong
    assert identity.flange_mismatch(ours, np.full((4, 4), math.nan))


def test_a_rotation_vector_is_a_rotation() -> None:
    for axis in range(3):
        for angle in (0.0, 1e-9, 0.3, -2.0, math.pi):
            values = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]
            values[3 + axis] = angle
            pose = identity.ur_pose(values)
            np.testing.assert_allclose(pose[:3, :3], rotation(axis, angle), atol=1e-12)
            assert pose[:3, 3].tolist() == [0.1, 0.2, 0.3]


def test_the_tcp_is_taken_off_and_the_base_turned() -> None:
    """The flange of a pose with an offset is the pose that the offset starts from."""
    rng = np.random.default_rng(3)
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    for _ in range(50):
        flange, offset = rng.uniform(-1, 1, 6), rng.uniform(-0.3, 0.3, 6)
        tcp = identity.ur_pose(flange) @ identity.ur_pose(offset)
        angle = math.acos(np.clip((np.trace(tcp[:3, :3]) - 1) / 2, -1, 1))
        R = tcp[:3, :3]
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        vector = angle * axis / (2 * math.sin(angle))
        result = identity.ur_flange([*tcp[:3, 3], *vector], offset.tolist())
        np.testing.assert_allclose(result, turn @ identity.ur_pose(flange), atol=1e-9)
