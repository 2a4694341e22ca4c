"""A task as LeRobot's environments are: the same episode as `SurgEnv`, in other words."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")

from gymnasium.utils.env_checker import check_env

from surg_core.contract import ARM_STATE
from surg_sim.envs.agent_env import AgentEnv
from surg_sim.envs.surg_env import SurgEnv

SEED = 20_000


@pytest.fixture(scope="module")
def env() -> AgentEnv:
    return AgentEnv("pick_and_place", images=())


def test_gymnasium_s_checker_passes_and_pictures_are_there() -> None:
    env = AgentEnv("pick_and_place", width=96, height=64)
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=SEED)
    left, shown = seen["pixels"]["endoscope.left"], env.render()
    assert left.shape == (64, 96, 3) and left.std() > 5
    assert isinstance(shown, np.ndarray)
    np.testing.assert_array_equal(left, shown)


def test_it_is_called_as_lerobot_asks(env: AgentEnv) -> None:
    assert env.get_wrapper_attr("_max_episode_steps") > 20 * 10
    assert env.get_wrapper_attr("task") == "pick_and_place"
    assert env.get_wrapper_attr("task_description").startswith("Move the ring")


def test_changes_give_the_way_of_places(env: AgentEnv) -> None:
    """An action of the dataset's space `relative` is counted from the command in force."""
    absolute, relative = env, AgentEnv("pick_and_place", images=(), steps=7, space="relative")
    assert relative.get_wrapper_attr("_max_episode_steps") == 7
    begin, _ = absolute.reset(seed=SEED)
    relative.reset(seed=SEED)
    target = begin["agent_pos"][[5, 6, 7, 8, 4]]
    for _ in range(5):
        target = target + np.array([0.0005, 0.0, 0.001, 0.01, 0.0])
        there, *_ = absolute.step(target)
        change = np.array([0.0005, 0.0, 0.001, 0.01, target[4]])
        mine, *_ = relative.step(change)
        np.testing.assert_allclose(mine["agent_pos"], there["agent_pos"], atol=1e-9)
    assert np.linalg.norm(there["agent_pos"][:3] - begin["agent_pos"][:3]) > 0.003


def test_its_episode_is_the_phantoms_own(env: AgentEnv) -> None:
    """The expert's actions through both: numbers equal to the bit, the same end, a success."""
    plain = SurgEnv("pick_and_place")
    observation, _ = plain.reset(seed=SEED)
    mine, _ = env.reset(seed=SEED)
    done, steps = False, 0
    while not done:
        place = {name: i for i, name in enumerate(plain.state_names)}
        wanted = observation["state"][[place[f"PSM1/{name}"] for name in ARM_STATE]]
        np.testing.assert_array_equal(mine["agent_pos"], wanted)
        action = plain.expert_action()
        observation, reward, done, late, info = plain.step(action)
        mine, my_reward, my_end, my_late, my_info = env.step(action)
        assert (my_reward, my_end, my_late) == (reward, done, late)
        done, steps = done or late, steps + 1
        assert my_info["is_success"] == info["success"]
    assert my_info["is_success"] is True
    assert steps < env.get_wrapper_attr("_max_episode_steps")
