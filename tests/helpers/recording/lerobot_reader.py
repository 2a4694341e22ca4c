"""Reads a dataset with the real lerobot, in an environment of its own; prints JSON lines.

Usage: ``python lerobot_reader.py DATASET[:DATASET…] FRAMES SEED``: the versions first, then per
dataset its facts, and per sampled frame what lerobot gives. At most ``FRAMES`` of each are sampled,
in random order, because a training program reads so.
"""

from __future__ import annotations

import json
import random
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas
import torch

# The compiled part of torchvision is of another build than a CPU-only torch. lerobot needs its
# transforms only, but torchvision does not import unless these operators are known.
if torch.__version__.endswith("+cpu"):
    _OPERATORS = torch.library.Library("torchvision", "DEF")
    for _name in ("nms", "qnms"):
        _OPERATORS.define(f"{_name}(Tensor a, Tensor b, float c) -> Tensor")

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from helpers.recording import picture_identity

VERSIONS = ("lerobot", "torch", "torchvision", "torchcodec", "datasets", "pyarrow", "numpy")


def _stage(meta: Any, item: dict[str, Any]) -> str:
    """The stage in words: lerobot's own sub-task, or GR00T's place in the list of tasks."""
    if "subtask_index" in meta.features:
        if metadata.version("lerobot") < "0.6":
            return str(item["subtask"])
        # It no longer reads the table of sub-tasks, but the places in it.
        texts = pandas.read_parquet(meta.root / "meta" / "subtasks.parquet")
        return str(texts.index[int(item["subtask_index"])])
    return str(meta.tasks[int(item["annotation.human.action.subtask_description"])])


def main(root: str, count: int, seed: int) -> None:
    """Print facts and frames."""
    dataset = LeRobotDataset("local/export", root=root)
    meta = dataset.meta
    facts = {
        "frames": len(dataset),
        "episodes": meta.total_episodes,
        "fps": meta.fps,
        "robot": meta.robot_type,
        "cameras": meta.camera_keys,
        "mean": {key: value["mean"].tolist() for key, value in meta.stats.items()},
        "std": {key: value["std"].tolist() for key, value in meta.stats.items()},
    }
    print(json.dumps(facts))
    chosen = random.Random(seed).sample(range(len(dataset)), min(count, len(dataset)))
    for index in chosen:
        item = dataset[index]
        found = {
            "index": int(item["index"]),
            "asked": index,
            "episode": int(item["episode_index"]),
            "frame": int(item["frame_index"]),
            "timestamp": float(item["timestamp"]),
            "grid_ns": int(item["timing.grid_ns"]),
            "task": item["task"],
            "stage": _stage(meta, item),
            "stage_text": item["instruction.stage"],
            "tool": item["observation.meta.tool"],
            "state": item["observation.state"].tolist(),
            "action": item["action"].tolist(),
            "cartesian": item["observation.cartesian_state"].tolist(),
            "force": item.get("observation.force", torch.empty(0)).tolist(),
            "camera_pose": item.get("observation.camera_pose", torch.empty(0)).tolist(),
            "pictures": {},
            "shades": {},
        }
        for key in meta.camera_keys:
            image = item[key].permute(1, 2, 0).numpy()
            found["shades"][key] = (255 * picture_identity.shades(image)[1]).tolist()
            try:
                shown = picture_identity.read(image)
                found["pictures"][key] = [shown.recording, shown.camera, shown.frame]
            except ValueError:
                found["pictures"][key] = None
        print(json.dumps(found))


if __name__ == "__main__":
    print(json.dumps({name: metadata.version(name) for name in VERSIONS}))
    for _root in sys.argv[1].split(":"):
        main(_root, int(sys.argv[2]), int(sys.argv[3]))
