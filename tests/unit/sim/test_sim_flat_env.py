"""Environments for reinforcement learning: spaces, random actions that move, dense rewards."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from conftest import FULL

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from surg_sim.envs.flat_env import BOUND, FlatEnv  # noqa: E402

STEPS = 400 if FULL else 60


@pytest.fixture(scope="module")
def bgr() -> FlatEnv:
    return gymnasium.make("surg_sim/bgr-dense-v0").unwrapped


def test_gymnasium_s_checker_passes_without_a_word(bgr: FlatEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(bgr, skip_render_check=True)
    assert bgr.observation_space.dtype == bgr.action_space.dtype == np.float32
    assert np.isfinite(bgr.observation_space.low).all()
    assert bgr.observation_space.shape == (len(bgr.observation_names),)


@pytest.mark.parametrize("kind", ["uniform", "corners"])
def test_random_actions_move_the_tip_and_are_never_refused(bgr: FlatEnv, kind: str) -> None:
    rng = np.random.default_rng(4)
    observation, _ = bgr.reset(seed=10_000)
    at = [bgr.observation_names.index(f"PSM1/tip_{axis}") for axis in "xyz"]
    tips, rcm = [observation[at]], 0.0
    held = np.zeros(5)
    for k in range(STEPS):
        if k % 10 == 0:  # held for half a second, so that the workspace's walls are reached
            held = rng.uniform(-1, 1, 5) if kind == "uniform" else rng.choice([-1.0, 1.0], 5)
        observation, _, over, late, info = bgr.step(held.astype(np.float32))
        tips.append(observation[at])
        rcm = max(rcm, info["rcm_error"]["PSM1"])
        if over or late:
            break
    path = float(np.linalg.norm(np.diff(np.array(tips), axis=0), axis=1).sum())
    print(f"{kind}: {len(tips)} steps, {1e3 * path:.0f} mm, {info['refused']} refused")
    assert info["refused"] == 0
    assert path > 1e-3 * len(tips)
    assert rcm < 1e-3


def test_dense_rewards_add_up_to_the_progress(bgr: FlatEnv) -> None:
    bgr.reset(seed=10_001)
    before, total = bgr.env.session.task.progress(), 0.0
    assert before is not None
    for _ in range(20):
        *_, info = result = bgr.step(np.array([0.3, -0.2, 0.8, 0.0, 1.0], dtype=np.float32))
        total += result[1]
    after = bgr.env.session.task.progress()
    assert after is not None
    assert total == pytest.approx(after - before, abs=1e-9)
    assert total != 0.0
    assert info["phase"] in ("point", "grasp")


@pytest.mark.skipif(not FULL, reason="a whole episode: --full")
def test_the_expert_s_progress_goes_from_its_beginning_to_one() -> None:
    env = gymnasium.make("surg_sim/bgr-dense-v0").unwrapped
    env.reset(seed=20_000)
    inner, task = env.env, env.env.session.task
    progress, over = [task.progress()], False
    while not over:
        *_, over, late, info = inner.step(inner.expert_action())
        progress.append(task.progress())
        over = over or late
    assert info["success"], info
    assert progress[0] < 0.2
    assert progress[-1] == 1.0
    assert np.mean(np.diff(progress) >= -0.02) > 0.95  # towards success almost always


def test_observations_are_clipped_and_finite() -> None:
    env = FlatEnv("pick_and_place", privileged=False)
    observation, _ = env.reset(seed=1)
    assert env.observation_names == env.env.state_names
    flat = env._flat({"state": np.array([np.nan, np.inf, -np.inf, 1e9])})
    assert flat.tolist() == [0.0, BOUND, -BOUND, BOUND]
    assert observation.dtype == np.float32


def test_a_task_without_progress_has_no_dense_reward() -> None:
    with pytest.raises(ValueError, match="pick_and_place"):
        FlatEnv("pick_and_place", reward="dense")
    with pytest.raises(ValueError, match="allowed are task, dense"):
        FlatEnv("bgr", reward="shaped")
