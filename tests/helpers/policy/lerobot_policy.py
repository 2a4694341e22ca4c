"""Makes a small ACT checkpoint with the real lerobot and asks it through our adapter; prints JSON.

Usage: ``python lerobot_policy.py FOLDER``. The weights are random: what is compared is the way of
an observation into the policy and of its chunk out of it. Compared with are lerobot's pipeline and
its asynchronous policy server.
"""

from __future__ import annotations

import json
import sys
from importlib import metadata
from pathlib import Path

import torch

# The compiled part of torchvision is of another build than a CPU-only torch. lerobot needs its
# transforms only, but torchvision does not import unless these operators are known.
_OPERATORS = torch.library.Library("torchvision", "DEF")
for _name in ("nms", "qnms"):
    _OPERATORS.define(f"{_name}(Tensor a, Tensor b, float c) -> Tensor")

import lerobot_server  # noqa: E402
import numpy as np  # noqa: E402
from lerobot.configs.types import FeatureType, PolicyFeature  # noqa: E402
from lerobot.policies.act.configuration_act import ACTConfig  # noqa: E402
from lerobot.policies.act.modeling_act import ACTPolicy  # noqa: E402
from lerobot.policies.factory import make_pre_post_processors  # noqa: E402

from surg_policy_client import ActionSpec, Observation, Spec  # noqa: E402
from surg_policy_client.adapters.lerobot import LeRobotPolicy  # noqa: E402

STATE, LEFT = "observation.state", "observation.images.endoscope.left"
ROWS = 20


def checkpoint(folder: Path) -> tuple[ACTPolicy, object, object]:
    """Save a policy with its processors; returns them."""
    config = ACTConfig(
        input_features={
            STATE: PolicyFeature(type=FeatureType.STATE, shape=(9,)),
            LEFT: PolicyFeature(type=FeatureType.VISUAL, shape=(3, 48, 64)),
        },
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(5,))},
        device="cpu",
        chunk_size=ROWS,
        n_action_steps=ROWS,
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
    )
    policy = ACTPolicy(config).eval()
    rng = np.random.default_rng(1)
    stats = {
        key: {"mean": torch.tensor(rng.normal(size=n)), "std": torch.tensor(rng.uniform(1, 2, n))}
        for key, n in ((STATE, 9), ("action", 5))
    }
    colours = {"mean": torch.full((3, 1, 1), 0.5), "std": torch.full((3, 1, 1), 0.2)}
    before, after = make_pre_post_processors(config, dataset_stats={**stats, LEFT: colours})
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)
    return policy, before, after


def main(folder: Path) -> None:
    """Compare."""
    torch.manual_seed(0)
    policy, before, after = checkpoint(folder)
    rng = np.random.default_rng(2)
    state = rng.normal(size=9).astype(np.float32)
    picture = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    for array in (state, picture):
        array.flags.writeable = False  # as they come off the wire
    names = tuple("abcde")
    spec = Spec("bgr", 0.05, {}, ActionSpec(names, ("m",) * 5))
    observation = Observation({STATE: state, LEFT: picture}, 0, 0, 0, "retract", spec)

    # lerobot's own way, with a frame as its dataset gives one.
    frame = {
        STATE: torch.tensor(state)[None],
        LEFT: (torch.tensor(picture).permute(2, 0, 1) / 255.0)[None],
        "task": ["retract"],
    }
    policy.reset()
    with torch.inference_mode():
        wanted = after(policy.predict_action_chunk(before(frame)))[0].numpy()

    adapted = LeRobotPolicy.from_pretrained(str(folder))
    adapted.reset("retract", 3)
    rows = adapted.act(observation)
    served = lerobot_server.chunk(folder, state, {LEFT: picture}, ROWS, "retract")
    print(
        json.dumps(
            {
                "lerobot": metadata.version("lerobot"),
                "wants": list(adapted.wants.observation),
                "shape": list(rows.shape),
                "dtype": str(rows.dtype),
                "worst": float(np.abs(rows - wanted).max()),
                "worst_served": float(np.abs(rows - served).max()),
                "spread": float(wanted.std()),
                "refused": spec.check_chunk(rows),
            }
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
