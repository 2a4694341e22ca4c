"""The environments: spaces, determinism, scores of policies that must fail."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from conftest import FULL
from surg_core.wilson import wilson_interval
from surg_sim.envs.episode_runner import run_episode
from surg_sim.tasks import episode_seeds

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from surg_core.arm_view import ArmState, ArmView  # noqa: E402
from surg_core.contract import ARM_ACTION, ARM_STATE  # noqa: E402
from surg_sim.envs.surg_env import SurgEnv  # noqa: E402

Policy = Callable[[SurgEnv, dict[str, Any]], Any]


def play(env: SurgEnv, policy: Policy, seed: int) -> dict[str, Any]:
    observation, info = env.reset(seed=seed)
    total, done = 0.0, False
    while not done:
        observation, reward, terminated, truncated, info = env.step(policy(env, observation))
        total += reward
        done = terminated or truncated
    return {**info, "total": total, "truncated": truncated}


def expert(env: SurgEnv, observation: dict[str, Any]) -> Any:
    del observation
    return env.expert_action()


def still(env: SurgEnv, observation: dict[str, Any]) -> Any:
    del env
    state = observation["state"]
    return np.array([*state[5:9], state[4]])


def random(env: SurgEnv, observation: dict[str, Any]) -> Any:
    del observation
    return env.action_space.sample()


@pytest.fixture(scope="module")
def pegs() -> SurgEnv:
    return SurgEnv("pick_and_place")


def test_gymnasium_s_checker_passes(pegs: SurgEnv) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(pegs, skip_render_check=True)
    # It would like spaces without units; what else it says would be an error of ours.
    others = [str(w.message) for w in said if "Box" not in str(w.message)]
    assert not [text for text in others if "not equal" in text], others


def test_names_and_spaces_agree(pegs: SurgEnv) -> None:
    observation, info = pegs.reset(seed=1)
    assert pegs.observation_space.contains(observation)
    assert pegs.state_names == [f"PSM1/{name}" for name in ARM_STATE]
    assert pegs.action_names == [f"PSM1/{name}" for name in ARM_ACTION]
    assert set(observation["privileged"]) == set(pegs.session.task.state())
    assert (info["seed"], info["success"], info["phase"]) == (1, False, "grasp")


def test_an_episode_is_the_session_s_bit_for_bit(pegs: SurgEnv) -> None:
    seed = episode_seeds.TEST[0]
    info = play(pegs, expert, seed)
    assert info["success"], info
    through_env = pegs.session.hash
    assert run_episode(pegs.session, seed).hash == through_env


def test_a_bad_action_is_named(pegs: SurgEnv) -> None:
    pegs.reset(seed=1)
    with pytest.raises(ValueError, match="5 finite numbers are needed: PSM1/x"):
        pegs.step(np.array([0.0, 0.0, np.nan, 0.0, 0.0]))
    with pytest.raises(ValueError, match="5 finite numbers"):
        pegs.step(np.zeros(4))
    with pytest.raises(ValueError, match="left, right"):
        SurgEnv("pick_and_place", images=("front",))


def test_a_step_that_is_too_large_is_refused_not_clipped(pegs: SurgEnv) -> None:
    observation, _ = pegs.reset(seed=1)
    action = still(pegs, observation)
    pegs.step(action)
    before = pegs.step(action)[4]["refused"]
    action[0] += 0.05
    assert pegs.step(action)[4]["refused"] == before + 1


@pytest.mark.parametrize("task", ["bgr", "pick_and_place"])
def test_policies_score_as_they_should(task: str) -> None:
    env = SurgEnv(task, cell="sim_ur5e")
    n = 100 if FULL else 1
    policies = [(still, 0.0, 0.0), (random, 0.0, 0.0), (expert, 0.9, 1.0)]
    for policy, low, high in policies if FULL or task == "pick_and_place" else policies[::2]:
        env.action_space.seed(0)
        if not FULL:
            long = 12.0 if task == "bgr" else 8.0
            env.session.task.time_limit = long if policy is expert else 3.0  # type: ignore[misc]
        good = sum(play(env, policy, seed)["success"] for seed in episode_seeds.test_seeds(n))
        interval = wilson_interval(good, n)
        print(f"{task}: {policy.__name__}: {good}/{n}, 95 % interval {interval}")
        assert low <= good / n <= high
        assert not FULL or policy is not expert or interval[0] >= 0.9


def test_an_arm_that_does_not_come_up_is_no_observation(
    pegs: SurgEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ready is what every arm must be; a bring-up that ended otherwise raises."""
    true = ArmView.of
    monkeypatch.setattr(ArmView, "of", lambda out: replace(true(out), state=ArmState.FAULT))
    with pytest.raises(RuntimeError, match="PSM1: the arm is in FAULT"):
        pegs.reset(seed=1)
