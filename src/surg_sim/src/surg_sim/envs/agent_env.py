"""A task for programs that want ``agent_pos`` and ``pixels``, as LeRobot's environments give them.

The numbers and pictures are those of an exported dataset, so a policy that was trained on one sees
the same here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from surg_core.action_space import ABSOLUTE
from surg_core.contract import ARM_STATE, GRID_RATE, IMAGE_PREFIX, STATE_KEY, image_key
from surg_sim.arrays import Array
from surg_sim.envs.policy_rollouts import observe
from surg_sim.envs.surg_env import SurgEnv


def camera(view: str) -> str:
    """Name of a view's pictures: ``left`` is ``endoscope.left``, as a dataset's key ends."""
    return image_key(f"endoscope_{view}").removeprefix(IMAGE_PREFIX)


class AgentEnv(gymnasium.Wrapper[dict[str, Any], Array, dict[str, Any], Array]):
    """A task; rewards and ends are those of `SurgEnv`, and ``info`` has ``is_success``.

    Observation: ``agent_pos``, the dataset's ``observation.state``; ``pixels``, a dict of pictures
    (height, width, 3), rgb8, by camera such as ``endoscope.left``.

    Args:
        task: Of ``tasks.names()``.
        images: Views, of ``surg_env.CAMERAS``.
        width: Of the pictures [px].
        height: [px].
        setting: Of ``patient_settings.SETTINGS``.
        steps: After which a program stops looking; None: the task's time limit.
        space: Of the actions, of ``contract.ACTION_SPACES``: the dataset's.
    """

    def __init__(
        self,
        task: str,
        images: Sequence[str] = ("left",),
        width: int = 640,
        height: int = 480,
        setting: str = "phantom",
        steps: int | None = None,
        space: str = ABSOLUTE,
    ) -> None:
        self._surg = SurgEnv(task, None, setting, images, width, height, "rgb_array", space=space)
        super().__init__(self._surg)
        played = self._surg.session.task
        self.task = task
        self.task_description = played.instruction or played.title
        # LeRobot's rollout reads it.
        self._max_episode_steps = steps or math.ceil(played.time_limit * GRID_RATE) + 1
        numbers = (len(ARM_STATE) * len(self._surg.arms),)
        picture = spaces.Box(0, 255, (height, width, 3), np.uint8)
        self.observation_space = spaces.Dict(
            {
                "agent_pos": spaces.Box(-np.inf, np.inf, numbers, np.float64),
                "pixels": spaces.Dict({camera(view): picture for view in images}),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; see `SurgEnv.reset`."""
        observation, info = self._surg.reset(seed=seed)
        return self._seen(observation), info

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Send one action and let 25 ticks pass; see `SurgEnv.step`."""
        observation, reward, ended, late, info = self._surg.step(action)
        return self._seen(observation), reward, ended, late, {**info, "is_success": info["success"]}

    def _seen(self, observation: dict[str, Any]) -> dict[str, Any]:
        seen = observe(self._surg, observation)
        pixels = {
            key.removeprefix(IMAGE_PREFIX): picture
            for key, picture in seen.items()
            if key.startswith(IMAGE_PREFIX)
        }
        return {"agent_pos": seen[STATE_KEY], "pixels": pixels}
