"""The phantom's tasks as environments of LeRobot: ``--env.type=surg_bgr`` and its neighbours.

An installed task of others (entry point ``surg_sim.tasks``) has a type too.
"""

from dataclasses import dataclass, field, make_dataclass
from functools import partial
from typing import Any

from gymnasium import vector
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from surg_core.contract import ACTION_KEY, ARM_ACTION, ARM_STATE, GRID_RATE, IMAGE_PREFIX, STATE_KEY
from surg_sim.envs.agent_env import AgentEnv, camera
from surg_sim.tasks import load, names


@dataclass(kw_only=True)
class SurgEnvConfig(EnvConfig):
    """Options ``--env.…`` of a task; each task is a subclass of its own."""

    fps: int = GRID_RATE
    cameras: list[str] = field(default_factory=lambda: ["left"])
    """Views of the endoscope: left, right."""
    observation_width: int = 640
    observation_height: int = 480
    """Of the pictures [px], as in training."""
    setting: str = "phantom"
    """Of the patient: docs/reference/simulation.md."""
    action_space: str = "absolute"
    """Of the dataset: docs/reference/policies.md."""
    episode_length: int | None = None
    """Longest episode in steps of 50 ms; None: the task's time limit."""

    def __post_init__(self) -> None:
        """Say what a policy sees and does."""
        arms = len(load(self.task).commanded)
        self.features = {
            ACTION_KEY: PolicyFeature(FeatureType.ACTION, (len(ARM_ACTION) * arms,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(ARM_STATE) * arms,)),
        }
        shape = (self.observation_height, self.observation_width, 3)
        pictures = [IMAGE_PREFIX + camera(view) for view in self.cameras]
        self.features |= {key: PolicyFeature(FeatureType.VISUAL, shape) for key in pictures}
        self.features_map = {key: key for key in self.features} | {"agent_pos": STATE_KEY}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """None: the environments are made here."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, vector.VectorEnv]]:
        """One suite of one task."""
        size = {"width": self.observation_width, "height": self.observation_height}
        more = {"setting": self.setting, "steps": self.episode_length, "space": self.action_space}
        made = [partial(AgentEnv, self.task, tuple(self.cameras), **size, **more)] * n_envs
        again = vector.AutoresetMode.SAME_STEP
        if use_async_envs and n_envs > 1:
            envs = vector.AsyncVectorEnv(made, context="forkserver", autoreset_mode=again)
        else:
            envs = vector.SyncVectorEnv(made, autoreset_mode=again)
        return {self.type: {0: envs}}


for _name in names():
    _kind = make_dataclass(f"Surg_{_name}", [("task", str, _name)], bases=(SurgEnvConfig,))
    EnvConfig.register_subclass(f"surg_{_name}")(_kind)
