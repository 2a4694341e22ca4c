"""Environments as learners expect them: one flat observation, relative actions, dense rewards.

``SurgEnv`` speaks the language of the recordings: a dict of observations, absolute actions in
metres. ``FlatEnv`` wraps it for reinforcement learning. Import this module, then ::

    env = gymnasium.make("surg_sim/bgr-dense-v0")

docs/guide/learning.md shows PPO on it.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import surg_core
from surg_core.contract import ARM_ACTION, GRID_RATE
from surg_sim.arrays import Array
from surg_sim.envs.surg_env import SurgEnv
from surg_sim.tasks import names

Float32 = NDArray[np.float32]

BOUND = 100.0
"""Largest observed number; SI values of the bundled tasks are far below it."""
REWARDS = ("task", "dense")

_START = 0.9  # of `step_slack`: the first step of a pose stream
_MARGIN = 1e-3  # [m] and [rad] that a target stays inside the workspace


class FlatEnv(gymnasium.Env[Float32, Float32]):
    """One task for a learner.

    Observation: ``observation_names``, float32, in SI units, within ``BOUND``. With ``privileged``
    it ends with the task's ground truth, which no policy for a robot may read. Action: per
    commanded arm five numbers from -1 to 1, the change of tip x, y, z, roll and jaw in one step.
    1 is the largest change that the controller never refuses. Targets stay inside the workspace.
    Termination, truncation and ``info`` are those of ``SurgEnv``.

    Args:
        task: Of ``tasks.names()``, or the path of a task's file.
        reward: ``task``: the task's own. ``dense``: the same, and the change of its ``progress``.
        privileged: Whether to observe the task's ground truth.
        **keywords: Of ``SurgEnv``: cell, setting, law, …; no images.

    Raises:
        ValueError: The reward is unknown, or the task has no ``progress``.
    """

    metadata = SurgEnv.metadata

    def __init__(
        self, task: str = "bgr", reward: str = "task", privileged: bool = True, **keywords: Any
    ) -> None:
        if reward not in REWARDS or "images" in keywords:
            raise ValueError(
                f"reward {reward!r}: allowed are {', '.join(REWARDS)}; 'images' belong to SurgEnv"
            )
        self.env = SurgEnv(task, **keywords)
        self.render_mode = self.env.render_mode
        self._dense, self._privileged = reward == "dense", privileged
        self._task = self.env.session.task
        if self._dense and self._task.progress() is None:
            raise ValueError(
                f"task '{self._task.name}' has no progress(), so no dense reward; use reward='task'"
            )
        self.observation_names = list(self.env.state_names)
        for key, value in self._task.state().items() if privileged else ():
            shape = np.shape(value)
            self.observation_names += [
                "/".join((key, *map(str, index))) for index in np.ndindex(*shape)
            ]
        size = len(self.observation_names)
        self.observation_space = spaces.Box(-BOUND, BOUND, (size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.env.action_names),), np.float32)
        arms = [self.env.session.cell.arms[name] for name in self.env.arms]
        self._arms = [RelativeTarget(arm.limits, arm.instrument) for arm in arms]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32, dict[str, Any]]:
        """Begin an episode; see ``SurgEnv.reset``. Without a seed one of the training seeds."""
        super().reset(seed=seed)
        observation, info = self.env.reset(seed=self.env.seed_of(seed, self.np_random))
        self._start(observation)
        self._refused, self._progress = info["refused"], self._task.progress() or 0.0
        return self._flat(observation), info

    def step(self, action: Float32) -> tuple[Float32, float, bool, bool, dict[str, Any]]:
        """Move the targets and let 50 ms pass.

        Raises:
            ValueError: The action has the wrong length or is not finite.
        """
        values = np.asarray(action, dtype=np.float64)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ValueError(f"action {values.tolist()}: {self.action_space} is needed")
        parts = np.clip(values, -1.0, 1.0).reshape(len(self._arms), len(ARM_ACTION))
        targets = [arm.move(part) for arm, part in zip(self._arms, parts, strict=True)]
        observation, reward, terminated, truncated, info = self.env.step(np.concatenate(targets))
        if info["refused"] != self._refused:  # the arm stays at its set-point: begin again there
            self._refused = info["refused"]
            self._start(observation)
        if self._dense:
            progress = self._task.progress() or 0.0
            reward += progress - self._progress
            self._progress = progress
        return self._flat(observation), float(reward), terminated, truncated, info

    def _start(self, observation: dict[str, Any]) -> None:
        state = dict(zip(self.env.state_names, observation["state"], strict=True))
        for name, arm in zip(self.env.arms, self._arms, strict=True):
            keys = ("set_x", "set_y", "set_z", "roll_set", "jaw")
            arm.start(np.array([state[f"{name}/{key}"] for key in keys]))

    def _flat(self, observation: dict[str, Any]) -> Float32:
        parts = [observation["state"]]
        if self._privileged:
            parts += [np.ravel(value) for value in observation["privileged"].values()]
        flat = np.nan_to_num(np.concatenate(parts), nan=0.0, posinf=BOUND, neginf=-BOUND)
        return np.clip(flat, -BOUND, BOUND).astype(np.float32)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """The left camera's picture in mode ``rgb_array``."""
        return self.env.render()

    def close(self) -> None:
        """Release what the environment holds."""
        self.env.close()


class RelativeTarget:
    """An arm's target: tip [m], roll [rad] in the rcm frame, jaw [rad].

    Args:
        limits: Of the arm.
        instrument: In its hand.
    """

    def __init__(self, limits: surg_core.Limits, instrument: surg_core.InstrumentConfig) -> None:
        self._limits = limits
        self._jaw = float(instrument.jaw_min), float(instrument.jaw_max)
        along_axis = float(limits.tip_velocity) / math.sqrt(3.0)  # so that no diagonal is too fast
        rates = [along_axis] * 3 + [float(limits.roll_velocity), float(instrument.jaw_velocity)]
        self.most = np.array(rates) / GRID_RATE
        """Largest change of one step [m, m, m, rad, rad], (5,)."""
        self.value = np.zeros(len(ARM_ACTION))

    def start(self, value: Array) -> None:
        """Begin at this target; the next step is the first one of a pose stream."""
        self.value, self._first = value.copy(), True

    def move(self, action: Array) -> Array:
        """The next target for an action from -1 to 1, (5,)."""
        change = self.most * action
        if self._first:
            slack = float(self._limits.step_slack), float(self._limits.step_roll_slack)
            change[:3] *= min(1.0, _START * slack[0] / max(float(np.linalg.norm(change[:3])), 1e-9))
            change[3] = np.clip(change[3], -_START * slack[1], _START * slack[1])
            self._first = False
        wanted = self.value + change
        tip = self._inside(wanted[:3])
        if surg_core.inside_workspace(self._limits, tip):
            self.value[:3] = tip
        self.value[3] = np.clip(wanted[3], -self._limits.roll_max, self._limits.roll_max)
        self.value[4] = np.clip(wanted[4], *self._jaw)
        return self.value.copy()

    def _inside(self, p: Array) -> Array:
        """The nearest target in the cone, and deep enough that the tip may move sideways."""
        limits = self._limits
        depth = float(np.linalg.norm(p))
        aside = p[:2] / max(float(np.linalg.norm(p[:2])), 1e-9)
        tilt = min(math.atan2(float(np.linalg.norm(p[:2])), float(p[2])), limits.cone - _MARGIN)
        depth = float(np.clip(depth, limits.depth_slow + _MARGIN, limits.depth_max - _MARGIN))
        return depth * np.array([*(math.sin(tilt) * aside), math.cos(tilt)])


def register() -> None:
    """Make ``surg_sim/<task>-flat-v0`` of all named tasks and ``<task>-dense-v0`` available."""
    for name in names():
        for reward, word in (("task", "flat"), ("dense", "dense")):
            key = f"surg_sim/{name}-{word}-v0"
            if key not in gymnasium.registry:
                gymnasium.register(
                    key,
                    entry_point="surg_sim.envs.flat_env:FlatEnv",
                    kwargs={"task": name, "reward": reward},
                )


register()
