"""A policy trained with LeRobot on a dataset of `./surg export`.

Dataset and wire use the same keys. Needs lerobot (0.4 or later) and torch, as no other module of
this library does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Callable, Sequence

import numpy as np

from surg_policy_client.observation import Observation
from surg_policy_client.spec import ActionSpec, Spec

Step = Callable[[Any], Any]


class LeRobotPolicy:
    """A pre-trained LeRobot policy; returns its whole chunks.

    Args:
        policy: Has ``predict_action_chunk(batch)`` and ``reset()``, and a ``config`` with
            ``input_features``.
        preprocess: Applied to a batch; default: none.
        postprocess: Applied to the actions; default: none.
        device: Of the policy's tensors.
        action: Of the training data, if its action space is not the absolute one: such as
            ``ActionSpec.of_space("relative", ["PSM1"])``.
    """

    def __init__(
        self,
        policy: Any,
        preprocess: Step = lambda batch: batch,
        postprocess: Step = lambda actions: actions,
        device: str = "cpu",
        action: ActionSpec | None = None,
    ) -> None:
        self._policy, self._before, self._after = policy, preprocess, postprocess
        self._device = device
        self._keys = tuple(policy.config.input_features)
        self.wants: Sequence[str] | Spec = self._keys
        if action is not None:
            self.wants = replace(Spec.of_keys(self._keys), action=action)
        self.name = f"lerobot {getattr(policy, 'name', type(policy).__name__)}"

    @classmethod
    def from_pretrained(
        cls, path: str, device: str = "cpu", action: ActionSpec | None = None
    ) -> LeRobotPolicy:
        """Load a checkpoint, a folder or a name on the hub, with its pre- and post-processor."""
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors

        config = PreTrainedConfig.from_pretrained(path)
        config.device = device
        policy = get_policy_class(config.type).from_pretrained(path, config=config)
        policy.to(device).eval()
        override = {"device_processor": {"device": device}}
        before, after = make_pre_post_processors(
            config, pretrained_path=path, preprocessor_overrides=override
        )
        return cls(policy, before, after, device, action)

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode."""
        if seed is not None:
            import torch

            torch.manual_seed(seed)
        self._policy.reset()

    def act(self, observation: Observation) -> np.ndarray:
        """The chunk [K, A] for the grid times after the observation's."""
        import torch

        batch: dict[str, Any] = {"task": [observation.instruction]}
        for key in self._keys:
            value = torch.from_numpy(np.array(observation[key]))  # a copy: the view is read-only
            if value.dtype == torch.uint8:  # a picture: channels first, 0 to 1
                value = value.permute(2, 0, 1).float() / 255.0
            batch[key] = value.float()[None].to(self._device)
        with torch.inference_mode():
            actions = self._after(self._policy.predict_action_chunk(self._before(batch)))
        rows: np.ndarray = actions[0].float().cpu().numpy()
        return rows
