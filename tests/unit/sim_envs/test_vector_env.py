"""Environments with pictures side by side in processes, through shared memory of gymnasium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")

from surg_sim.appearance.domain_randomization import DomainRandomization  # noqa: E402
from surg_sim.appearance.opengl import NoOpenGL, choose_backend  # noqa: E402
from surg_sim.envs.surg_env import SurgEnv  # noqa: E402

SEEDS = [3, 4]
STEPS = 6
KEYWORDS: dict[str, Any] = {
    "cell": "sim_ur5e",
    "images": ("left",),
    "width": 64,
    "height": 48,
    "randomization": DomainRandomization(),
}


def still(state: np.ndarray) -> np.ndarray:
    """Set-point and jaw of each environment's state, (n, 5)."""
    return np.column_stack([state[:, 5:9], state[:, 4]])


@pytest.fixture(scope="module")
def alone() -> list[list[dict[str, Any]]]:
    """Observations of each seed's first steps, one episode after another in this process."""
    try:
        choose_backend()
    except NoOpenGL as error:
        pytest.skip(str(error))
    env, found = SurgEnv("pick_and_place", **KEYWORDS), []
    for seed in SEEDS:
        seen = [env.reset(seed=seed)[0]]
        for _ in range(STEPS):
            seen.append(env.step(still(seen[-1]["state"][None])[0])[0])
        found.append(seen)
    env.close()
    return found


@pytest.mark.parametrize(
    ("copy", "context"), [pytest.param(True, "fork", marks=pytest.mark.full), (False, "spawn")]
)
def test_pictures_and_states_are_those_of_one_process(
    copy: bool, context: str, alone: list[list[dict[str, Any]]]
) -> None:
    """Bit for bit; without copies what a step returns is the shared memory itself."""
    vector = gymnasium.make_vec(
        "surg_sim/pick_and_place-v0",
        num_envs=len(SEEDS),
        vectorization_mode="async",
        vector_kwargs={"shared_memory": True, "copy": copy, "context": context},
        **KEYWORDS,
    )
    seen, info = vector.reset(seed=SEEDS)
    looks = [KEYWORDS["randomization"].draw(seed).light_strength for seed in SEEDS]
    np.testing.assert_array_equal(info["look"]["light_strength"], looks)
    first = seen["images"]["left"]
    for n in range(STEPS + 1):
        for which, expected in enumerate(alone):
            np.testing.assert_array_equal(seen["state"][which], expected[n]["state"])
            picture = expected[n]["images"]["left"]
            assert picture.std() > 10.0
            np.testing.assert_array_equal(seen["images"]["left"][which], picture)
        if n < STEPS:
            seen, *_ = vector.step(still(seen["state"]))
    assert np.shares_memory(first, seen["images"]["left"]) == (not copy)
    vector.close()
