"""The assistant's instrument: virtual joints, pivot, rates, refusals, place."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.results.tissue_results import note
from helpers.sim.assistant_pose import forward
from helpers.sim.phantom import Phantom, arm_of
from surg_core.transforms import virtual_joints
from surg_sim.appearance.patient import wall_height
from surg_sim.physics import scene
from surg_sim.physics.assistant_arm import (
    ACCELERATION,
    LOWER,
    UPPER,
    VELOCITY,
    AssistantCommand,
)
from surg_sim.physics.assistant_scene import port_frame, port_place

TICK = 0.002


@pytest.fixture
def phantom() -> Phantom:
    return Phantom()


def random_joints(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform([-1.1, -1.1, 0.03, -3.0], [1.1, 1.1, 0.2, 3.0])


@pytest.mark.parametrize("cell", ["sim_ur5e", "sim_panda"])
def test_the_simulated_tip_is_where_forward_says(cell: str, full: bool) -> None:
    phantom = Phantom(cell)
    phantom.model.geom_conaffinity[:] = 0  # the bowel would press on the jaws
    rng, worst = np.random.default_rng(2), 0.0
    for _ in range(20 if full else 2):
        joints = random_joints(rng)
        phantom.run(1500, joints)
        assistant = phantom.assistant
        X = assistant.X_WRcm @ forward(joints)
        R = phantom.data.xmat[phantom.model.body("assistant_tip").id].reshape(3, 3)
        worst = max(worst, np.abs(assistant.p_WTip - X[:3, 3]).max(), np.abs(R - X[:3, :3]).max())
        assert np.abs(assistant.joints - joints).max() < 1e-5
    assert worst < 1e-5
    note(
        "the assistant's tip against its virtual joints",
        20 if full else 2,
        f"within {max(worst, 1e-12):.0e} m and rad",
    )


def test_rates_are_limited_and_the_goal_is_not_passed(phantom: Phantom, full: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20 if full else 4):
        start, goal = phantom.assistant.target.copy(), random_joints(rng)
        path = [start, start]
        phantom.run(0, goal)
        for _ in range(1500):
            phantom.assistant.advance()
            path.append(phantom.assistant.target.copy())
        velocity = np.diff(path, axis=0) / TICK
        acceleration = np.diff(velocity, axis=0) / TICK
        assert (np.abs(velocity) <= VELOCITY * (1 + 1e-9)).all()
        assert (np.abs(acceleration) <= ACCELERATION * (1 + 1e-6)).all()
        low, high = np.minimum(start, goal), np.maximum(start, goal)
        assert (np.array(path) >= low - 1e-12).all() and (np.array(path) <= high + 1e-12).all()
        assert np.abs(path[-1] - goal).max() < 1e-9


def test_a_command_that_cannot_be_meant_is_refused(phantom: Phantom) -> None:
    assistant = phantom.assistant
    good = np.array([0.1, -0.1, 0.1, 0.5])
    phantom.run(1, good, 0.3)
    assert assistant.fault == ""
    for bad in (
        AssistantCommand(joints=np.array([0.1, np.nan, 0.1, 0.0])),
        AssistantCommand(joints=np.array([0.1, 0.1, np.inf, 0.0])),
        AssistantCommand(joints=np.zeros(3)),
        AssistantCommand(jaw=float("nan")),
    ):
        assistant.accept(bad)
        assert "needed" in assistant.fault
    phantom.run(1500)
    assert np.abs(assistant.joints - good).max() < 1e-5
    assert assistant.jaw == pytest.approx(0.3, abs=1e-6)
    assistant.accept(AssistantCommand(joints=good))
    assert assistant.fault == ""
    phantom.run(3000, np.array([9.0, -9.0, 9.0, -99.0]), 9.0)
    limits = [UPPER[0], LOWER[1], UPPER[2], LOWER[3]]
    assert np.abs(assistant.target - limits).max() < 1e-9
    assert assistant.jaw == pytest.approx(0.7, abs=1e-6)
    with pytest.raises(ValueError, match="no direction"):
        virtual_joints(np.zeros(3), 0.0)


def test_the_shaft_stays_in_its_trocar_and_stiff_under_load(phantom: Phantom) -> None:
    assistant, model, data = phantom.assistant, phantom.model, phantom.data
    before, gives = assistant.p_WTip, []
    for axis in np.eye(3):
        data.xfrc_applied[model.body("assistant_tip").id, :3] = 5.0 * axis
        phantom.run(300)
        give = 1e3 * np.linalg.norm(assistant.p_WTip - before)
        z = data.xmat[model.body("assistant_tip").id].reshape(3, 3)[:, 2]
        off = np.linalg.norm(np.cross(assistant.X_WRcm[:3, 3] - assistant.p_WTip, z))
        gives.append(give)
        assert give < 1.0
        assert off < 1e-9
    note("5 N at the assistant's tip", len(gives), f"gives {max(gives):.2f} mm at most")


@pytest.mark.parametrize("cell", ["sim_ur5e", "sim_panda"])
def test_it_comes_from_the_other_side_through_the_wall(cell: str) -> None:
    site = scene.site_of([arm_of(cell)])
    x, y, z = port_place(site)
    robot = site.local(site.trocar)
    print(f"{cell}: robot {robot.round(3)}, assistant {np.round([x, y, z], 3)} m")
    assert x * robot[0] < 0 or abs(robot[0]) < 0.02
    assert abs(x - robot[0]) > 0.06  # room for two cannulas and two hands
    assert z == pytest.approx(wall_height(site, x, y))
    assert wall_height(site, *robot[:2]) == pytest.approx(robot[2], abs=1e-9)
    X = port_frame(site)
    assert np.abs(X[:3, :3].T @ X[:3, :3] - np.eye(3)).max() < 1e-12
    assert X[:3, 2] @ (site.work - X[:3, 3]) > 0.05  # into the patient
