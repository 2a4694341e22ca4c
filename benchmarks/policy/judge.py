"""One roll-out of a policy of bgr under a condition of `sights`: scene, filters, and the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from policy.entrants import pictures_of, policy_of
from policy.sights import CONDITIONS, Condition, Filter, Replayed
from scipy.spatial.transform import Rotation

from surg_core.contract import image_key
from surg_sim.tasks.bgr import bgr_definition

CELL, TASK, SIZE = "sim_two_arms", "bgr", (640, 480)
TARGETS = bgr_definition.TARGETS
LEFT = image_key("endoscope_left")
OTHER = 500
"""The pictures of another episode are those of the first seed from so much further on whose place
is another one, for the judge too."""


@dataclass(frozen=True)
class Result:
    """One roll-out."""

    condition: str
    seed: int
    success: bool
    reason: str
    refused: int  # steps, by the controller
    rcm_max: float  # [m]


class Through:
    """A policy that gets views of the endoscope through filters.

    Args:
        policy: Answers.
        eyes: Filter of each picture that the policy reads, and the view that it is made of.
    """

    def __init__(self, policy: Any, eyes: Mapping[str, tuple[Filter, str]]) -> None:
        self._policy, self._eyes = policy, eyes
        self.acknowledged = policy.acknowledged

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode."""
        self._policy.reset(instruction, seed)

    def act(self, observation: Any) -> Any:
        """The policy's answer to what it is shown."""
        arrays = dict(getattr(observation, "arrays", observation))
        shown = {
            key: eye(arrays[image_key(f"endoscope_{view}")])
            for key, (eye, view) in self._eyes.items()
        }
        for _, view in self._eyes.values():
            arrays.pop(image_key(f"endoscope_{view}"), None)
        arrays |= shown
        seen = replace(observation, arrays=arrays) if hasattr(observation, "arrays") else arrays
        return self._policy.act(seen)


def views_of(condition: Condition, pictures: Sequence[str]) -> dict[str, str]:
    """The view that each picture shows that a policy reads: the condition's as the left one."""
    return {key: condition.view if key == LEFT else "right" for key in pictures}


def scene(condition: Condition, views: Sequence[str]) -> Any:
    """The environment of a condition, with these views."""
    from surg_sim.envs.surg_env import SurgEnv

    bgr_definition.TARGETS = condition.targets or TARGETS
    width, height = SIZE
    env = SurgEnv(
        TASK, CELL, condition.setting, views, width, height, randomization=condition.randomization
    )
    move_camera(env.session.world.model, condition, views)
    return env


def move_camera(model: Any, condition: Condition, views: Sequence[str]) -> None:
    """Put the cameras of these views where a condition has them."""
    from surg_sim.physics.endoscope_rig import FRAMES

    for view in views:
        camera = model.camera(FRAMES[view])
        stated = Rotation.from_quat(np.roll(camera.quat, -1))  # MuJoCo has w first
        turn = Rotation.from_euler("x", condition.turn, degrees=True)
        camera.pos[:] += stated.apply([condition.aside, 0.0, 0.0])
        camera.quat[:] = np.roll((stated * turn).as_quat(), 1)


def watched(env: Any, views: Sequence[str], seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Pictures of the expert's episode, by view."""
    seen, _ = env.reset(seed=seed)
    done = False
    while not done:
        yield {view: seen["images"][view].copy() for view in views}
        seen, _, terminated, truncated, _ = env.step(env.expert_action())
        done = terminated or truncated


def another(env: Any, seed: int) -> int:
    """The seed of an episode whose place is none of this one's."""

    def place(of: int) -> int:
        env.reset(seed=of)
        return int(env.session.task.target)

    own = place(seed)
    return next(s for s in count(seed + OTHER) if abs(place(s) - own) > bgr_definition.RIGHT)


def eyes_of(
    env: Any, condition: Condition, seed: int, shown: Mapping[str, str]
) -> dict[str, tuple[Filter, str]]:
    """Filter and view of each picture that a policy reads; both eyes meet the same."""
    if condition.eye is not None:
        made = condition.eye
        return {key: (made(np.random.default_rng(seed)), view) for key, view in shown.items()}
    kept = list(watched(env, list(shown.values()), another(env, seed)))
    return {key: (Replayed([each[view] for each in kept]), view) for key, view in shown.items()}


Job = tuple[str, int, Path]
"""Condition, seed, weights."""


def judge(job: Job) -> Result:
    """One roll-out, in a scene of its own."""
    from surg_sim.envs.policy_rollouts import roll_out

    name, seed, weights = job
    condition = next(each for each in CONDITIONS if each.name == name)
    learned = policy_of(weights)
    shown = views_of(condition, pictures_of(learned))
    env = scene(condition, tuple(dict.fromkeys(shown.values())))
    try:
        policy = Through(learned, eyes_of(env, condition, seed, shown))
        done = roll_out(env, policy, seed)
    finally:
        env.close()
    return Result(name, seed, done.success, done.reason, done.refused, done.rcm_max)
