"""Action spaces: what is encoded comes back, and means what the transforms say."""

from __future__ import annotations

import numpy as np
import pytest

from surg_core import action_space
from surg_core.action_space import ActionSpace
from surg_core.contract import ACTION_SPACES, ARM_ACTION
from surg_core.transforms import virtual_joints

ARMS = ("PSM1", "PSM2")
PERIOD = 0.05


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
