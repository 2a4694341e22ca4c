"""A policy in the environment, without wire, server and ROS: to choose and to compare by.

Observations have the names, units and order of an exported dataset (docs/reference/datasets.md), as
the model server serves them. What is measured here lacks the model server's safety controller and
its latencies. Figures that are published come from the graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from surg_core.contract import (
    ARM_FORCE,
    FORCE_KEY,
    STATE_KEY,
    TASK_STATE_KEY,
    TICK,
    image_key,
)
from surg_sim.arrays import Array
from surg_sim.envs.surg_env import SurgEnv


class Acts(Protocol):
    """What a policy is: surg_learn.bgr.state_policy.Policy, or any object like it."""

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode; the seed is for policies that draw."""

    def act(self, observation: Any) -> Array | None:
        """Actions for this step and the following ones, (K, A); None: those of before go on."""


@dataclass(frozen=True)
class Rollout:
    """How an episode went."""

    seed: int  # its seed
    success: bool  # whether it was one
    reason: str  # why not
    phase: str  # where it ended
    duration: float  # [s] simulated
    refused: int  # commands that the controller refused
    rcm_max: float  # largest kinematic deviation of the commanded arm [m]
    hash: str  # of the states of all ticks


def names(env: SurgEnv) -> dict[str, list[str]]:
    """Names of the numbers of each observation, as in a dataset."""
    flat = [
        "_".join([key, *map(str, place)])
        for key, value in env.session.task.state().items()
        for place in np.ndindex(np.shape(value))
    ]
    state = [name for name in env.state_names if name.partition("/")[0] in env.arms]
    force = [f"{arm}/{name}" for arm in env.arms for name in ARM_FORCE]
    return {STATE_KEY: state, FORCE_KEY: force, TASK_STATE_KEY: flat}


def observe(env: SurgEnv, observation: dict[str, Any]) -> dict[str, Any]:
    """An observation of the environment as a dataset has it; pictures too, where there are any."""
    place = {name: i for i, name in enumerate(env.state_names)}
    chosen = [place[name] for name in names(env)[STATE_KEY]]
    truth = [np.ravel(value) for value in observation["privileged"].values()]
    shown = observation.get("images", {})
    return {
        STATE_KEY: observation["state"][chosen],
        TASK_STATE_KEY: np.concatenate(truth),
        **({FORCE_KEY: observation["force"]} if "force" in observation else {}),
        **{image_key(f"endoscope_{name}"): picture for name, picture in shown.items()},
    }


def roll_out(env: SurgEnv, policy: Acts, seed: int) -> Rollout:
    """Play one episode of a policy in an environment, which is reset.

    Raises:
        ValueError: The policy's chunk is over and it says nothing new.
    """
    observation, info = env.reset(seed=seed)
    policy.reset(env.session.task.title, seed)
    done, worst = False, 0.0
    chunk, at = np.zeros((0, len(env.action_names))), 0
    while not done:
        fresh = policy.act(observe(env, observation))
        if fresh is not None:
            chunk, at = np.asarray(fresh), 0
        if at >= len(chunk):
            raise ValueError(
                f"no action: the chunk of {len(chunk)} is over, and none came after it"
            )
        observation, _, terminated, truncated, info = env.step(chunk[at])
        at, done = at + 1, terminated or truncated
        worst = max(worst, *(info["rcm_error"][arm] for arm in env.arms))
    return Rollout(
        seed=seed,
        success=info["success"],
        reason=info["reason"],
        phase=info["phase"],
        duration=(env.session.world.tick - 1) * TICK,
        refused=info["refused"],
        rcm_max=worst,
        hash=env.session.hash,
    )
