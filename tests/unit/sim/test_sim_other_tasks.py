"""Peg transfer and endoscope guidance: success, and what must be none."""

from __future__ import annotations

import numpy as np
import pytest

from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.tasks import episode_seeds
from surg_sim.tasks.endoscope_guidance import endoscope_guidance_task
from surg_sim.tasks.pick_and_place import pick_and_place_task
from surg_sim.tasks.pick_and_place.pick_and_place_expert import PegTransferExpert

SEED = episode_seeds.TEST[0]


@pytest.fixture(scope="module")
def pegs() -> CellSession:
    """A compiled peg board."""
    return CellSession(cell_files.find("sim_ur5e"), "pick_and_place", "ex_vivo")


def test_the_ring_is_put_over_the_other_peg(pegs: CellSession) -> None:
    for seed in episode_seeds.test_seeds(2):
        report = run_episode(pegs, seed)
        assert report.success, report.reason
        task = pegs.task
        assert isinstance(task, pick_and_place_task.PickAndPlace)
        off = task.ring - task.goal
        assert np.hypot(*off[:2]) < pick_and_place_task.ROUND_PEG
        assert off[2] < pick_and_place_task.TUBE_RADIUS + pick_and_place_task.ON_BOARD
        assert report.arms["PSM1"].kinematic.max < 0.3e-3


@pytest.mark.parametrize(
    ("share", "reason"),
    [(0.6, "the ring fell off the boards"), (0.8, "the ring was dropped beside the pegs")],
)
def test_a_ring_beside_the_pegs_is_a_failure(pegs: CellSession, share: float, reason: str) -> None:
    class Careless(PegTransferExpert):
        def act(self, view):  # type: ignore[no-untyped-def]
            way = view.task["goal"] - view.task["start"]
            view.task["goal"] = view.task["start"] + share * way
            return super().act(view)

    task = pick_and_place_task
    geometry = (task.ARM, task.RING_RADIUS, task.PEG_HEIGHT)
    report = run_episode(pegs, SEED, {"expert": Careless(pegs.cell, SEED, *geometry)})
    assert (report.success, report.reason) == (False, reason)


def test_a_ring_that_is_left_where_it_was_is_a_failure(
    pegs: CellSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pegs.task, "time_limit", 1.5, raising=False)
    report = run_episode(pegs, SEED, experts={})
    assert (report.success, report.reason) == (False, "time limit of 1.5 s in phase 'grasp'")


@pytest.fixture
def guidance(monkeypatch: pytest.MonkeyPatch) -> CellSession:
    """A short episode of it."""
    monkeypatch.setattr(endoscope_guidance_task, "DURATION", 5.0)
    monkeypatch.setattr(endoscope_guidance_task.EndoscopeGuidance, "time_limit", 7.0)
    return CellSession(cell_files.find("sim_two_arms"), "endoscope_guidance")


def test_the_tip_is_kept_in_the_middle_only_by_who_guides(guidance: CellSession) -> None:
    seed = episode_seeds.TEST[1]
    report = run_episode(guidance, seed)
    kept = guidance.task.state()["mean_error"]
    assert report.success, report.reason
    assert report.arms["ECM"].kinematic.max < 0.3e-3
    experts = dict(guidance.task.experts(guidance.cell, seed))
    del experts["expert"]
    idle = run_episode(guidance, seed, experts)
    left = guidance.task.state()["mean_error"]
    print(f"mean error {kept:.1f} px with, {left:.1f} px without guidance")
    assert left > 2.0 * kept
    assert idle.reward < report.reward


def test_a_tip_on_the_endoscopes_axis_has_no_error() -> None:
    """Between the cameras, at any distance; each picture alone sees it beside its centre."""
    session = CellSession(cell_files.find("sim_two_arms"), "endoscope_guidance")
    task = session.task
    assert isinstance(task, endoscope_guidance_task.EndoscopeGuidance)
    state = task.state()
    for distance in (0.05, 0.1, 0.15):
        task._data.xpos[task._body] = state["lens"] + distance * state["R_WLens"][:, 2]
        left, right = (480 * view.project(task.tip)[0] for view in task.views)
        assert np.hypot(*task.pixels()) < 1e-9
        disparity = 480 * task.views[0].f * 0.004 / distance
        assert np.allclose(left, [disparity / 2, 0.0]) and np.allclose(right, -left)


def test_a_view_projects_like_the_renderer() -> None:
    """The pinhole of the judge is that of ``render.Intrinsics``: both from the same fovy."""
    from surg_sim.appearance.render import Intrinsics

    session = CellSession(cell_files.find("sim_two_arms"), "endoscope_guidance")
    view = EndoscopeView(session.world.model, session.world.data)
    X = view.pose
    point = X[:3, 3] + X[:3, :3] @ np.array([0.011, -0.007, 0.09])
    pinhole = Intrinsics.from_fovy(640, 480, float(session.world.model.cam_fovy[0]))
    expected = pinhole.project(np.array([0.011, -0.007, 0.09])) - [pinhole.cx, pinhole.cy]
    assert np.allclose(480 * view.project(point)[0], expected, atol=1e-9)
    assert view.sees(point)
    assert not view.sees(X[:3, 3] - 0.1 * X[:3, 2])  # behind the lens
