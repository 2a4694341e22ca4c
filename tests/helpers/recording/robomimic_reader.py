"""Reads ``demos.hdf5`` with the real robomimic, in an environment of its own; prints JSON lines.

Usage: ``python robomimic_reader.py FILE SPLIT LENGTH``: the versions first, then for every sequence
that robomimic finds in a split, in random order, what it gives of each frame.
"""

from __future__ import annotations

import json
import random
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
from robomimic.utils.dataset import SequenceDataset

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from helpers.recording import picture_identity

CAMERAS = ("endoscope_left", "endoscope_right")
VERSIONS = ("robomimic", "torch", "h5py", "numpy")
GRID = "extra/timing.grid_ns"


def identities(pictures: Any) -> list[list[int] | None]:
    """What each picture says; None: nothing."""
    found: list[list[int] | None] = []
    for picture in pictures:
        try:
            shown = picture_identity.read(picture)
            found.append([shown.recording, shown.camera, shown.frame])
        except ValueError:
            found.append(None)
    return found


def main(file: str, split: str, length: int) -> None:
    """Print versions and sequences."""
    dataset = SequenceDataset(
        hdf5_path=file,
        obs_keys=("state", "force", *(f"{camera}_image" for camera in CAMERAS)),
        dataset_keys=("actions", "rewards", "dones", "timestamp", GRID),
        seq_length=length,
        filter_by_attribute=split,
    )
    print(json.dumps({name: metadata.version(name) for name in VERSIONS}))
    order = list(range(len(dataset)))
    random.Random(1).shuffle(order)
    for index in order:
        item = dataset[index]
        print(
            json.dumps(
                {
                    "grid_ns": item[GRID].tolist(),
                    "dones": item["dones"].tolist(),
                    "actions": item["actions"].tolist(),
                    "state": item["obs"]["state"].tolist(),
                    "force": item["obs"]["force"].tolist(),
                    "obs": [identities(item["obs"][f"{camera}_image"]) for camera in CAMERAS],
                    "next": [identities(item["next_obs"][f"{camera}_image"]) for camera in CAMERAS],
                }
            )
        )
    batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=4)))
    print(json.dumps({"batch": list(batch["obs"][f"{CAMERAS[0]}_image"].shape)}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
