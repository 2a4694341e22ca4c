"""A policy trained with LeRobot on a dataset of `./surg episode export`.

Dataset and wire use the same keys. Needs lerobot (0.4 or later) and torch, as no other module of
this library does. As a program it serves a checkpoint:
``python -m surg_policy_client.adapters.lerobot CHECKPOINT --server ADDRESS``.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Callable, Sequence

import numpy as np

from surg_policy_client.action_spec import ACTION_SPACES, ActionSpec
from surg_policy_client.adapters.scaled import scaled
from surg_policy_client.chunks import RecedingHorizon
from surg_policy_client.observation import Observation
from surg_policy_client.policies.command_line import run
from surg_policy_client.spec import Feature, Spec

Step = Callable[[Any], Any]
PICTURES = "observation.images."


class LeRobotPolicy:
    """A pre-trained LeRobot policy; returns its whole chunks.

    Args:
        policy: Has ``predict_action_chunk(batch)`` and ``reset()``, and a ``config`` with
            ``input_features``, whose ``shape`` is (n,), or (3, height, width) of a picture.
            Pictures of the server are scaled to it.
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
        features = policy.config.input_features
        self._shapes = {key: tuple(feature.shape) for key, feature in features.items()}
        wanted = {
            key: Feature(shape=None if key.startswith(PICTURES) else shape)
            for key, shape in self._shapes.items()
        }
        self.wants = Spec(observation=wanted, action=action)
        self.name = f"lerobot {getattr(policy, 'name', type(policy).__name__)}"

    @classmethod
    def from_pretrained(
        cls, path: str, device: str = "cpu", action: ActionSpec | None = None
    ) -> LeRobotPolicy:
        """Load a checkpoint, a folder or a name on the hub, with its pre- and post-processor.

        Args:
            path: Of lerobot's ``pretrained_model``.
            device: For torch, such as ``cuda``.
            action: See the class. By default that of the data set which the checkpoint was trained
                on, if it still lies where it lay.

        Raises:
            ValueError: There is no such device, the folder holds no checkpoint, or the data set
                has other actions.
        """
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors

        check_device(device)
        check_folder(Path(path))
        action = checked_action(Path(path), action)
        config = PreTrainedConfig.from_pretrained(path)
        config.device = device
        if hasattr(config, "pretrained_backbone_weights"):
            config.pretrained_backbone_weights = None  # the checkpoint's own: nothing is downloaded
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
        """The chunk [K, A] for the grid times after the observation's.

        Raises:
            SpecMismatch: A picture has other proportions than in training, or is smaller.
        """
        import torch

        batch: dict[str, Any] = {"task": [observation.instruction]}
        for key, shape in self._shapes.items():
            value = observation[key]
            if key.startswith(PICTURES):
                value = scaled(value, *shape[1:]).transpose(2, 0, 1) / np.float32(255.0)
            # A copy: the view is read-only.
            batch[key] = torch.from_numpy(np.array(value, np.float32))[None].to(self._device)
        with torch.inference_mode():
            actions = self._after(self._policy.predict_action_chunk(self._before(batch)))
        rows: np.ndarray = actions[0].float().cpu().numpy()
        return rows


def check_device(device: str) -> None:
    """Refuse a GPU that torch does not find.

    Raises:
        ValueError: Says what there is.
    """
    import torch

    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ValueError(
            f"device {device}: PyTorch {torch.__version__} finds no GPU; allowed here: cpu"
        )


def check_folder(path: Path) -> None:
    """Refuse a folder that is no checkpoint; a name on the hub is none.

    Raises:
        ValueError: Says which folder it is.
    """
    if path.is_dir() and not (path / "config.json").is_file():
        raise ValueError(
            f"{path} holds no checkpoint (config.json); name lerobot-train's folder "
            "checkpoints/last/pretrained_model"
        )


def checked_action(checkpoint: Path, asked: ActionSpec | None) -> ActionSpec | None:
    """The actions of a checkpoint, by the data set that it was trained on.

    Args:
        checkpoint: Folder with lerobot's ``train_config.json``, which says where the data set lies.
        asked: By the caller.

    Returns:
        What the data set has; what was asked for, if the data set is not there.

    Raises:
        ValueError: The data set's actions are others than those asked for.
    """
    try:
        trained = json.loads((checkpoint / "train_config.json").read_text("utf-8"))
        info = Path(trained["dataset"]["root"]) / "meta" / "info.json"
        names = tuple(json.loads(info.read_text("utf-8"))["features"]["action"]["names"])
    except (OSError, ValueError, KeyError, TypeError):
        return asked
    if asked is not None and asked.names != names:
        raise ValueError(
            f"{checkpoint} was trained with actions {', '.join(names)} ({info}), asked for are "
            f"{', '.join(asked.names)}"
        )
    found = ActionSpec.among(names)
    return found[1] if found is not None and found[1].names == names else asked


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is served, and how."""
    add = parser.add_argument
    add("checkpoint", help="folder pretrained_model of lerobot-train, or a name on the hub")
    add("--every", type=int, default=8, metavar="N", help="ask it at every Nth step (default 8)")
    add("--decay", type=float, metavar="D", help="blend chunks as ACT does, such as 0.01")
    add("--device", default="cpu", help="such as cuda (default cpu)")
    add(
        "--action-space",
        choices=sorted(ACTION_SPACES),
        help="of its data set (default: the data set's where it is found, else absolute)",
    )


def _made(options: argparse.Namespace) -> RecedingHorizon:
    space = options.action_space
    action = None if space is None else ActionSpec.of_space(space)
    policy = LeRobotPolicy.from_pretrained(options.checkpoint, options.device, action)
    return RecedingHorizon(policy, options.every, options.decay)


def main(argv: Sequence[str] | None = None) -> int:
    """Serve a checkpoint; returns the exit status."""
    return run(_made, "Serves a checkpoint of lerobot.", add_arguments, argv)


if __name__ == "__main__":
    sys.exit(main())
