"""A made-up dataset for the cloned policies, in memory and on disk: see `bgr_pictures`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from helpers.policy import bgr_pictures as made
from helpers.policy.bgr_synthetic import ACTION, STATE
from surg_learn.cloning import cloned_networks as cloned_networks
from surg_learn.cloning import cloned_policy as cloned_policy
from surg_learn.cloning import train_cloned as train_cloned
from surg_learn.cloning.training import recorded_steps

LEFT, RIGHT = recorded_steps.LEFT, recorded_steps.RIGHT
WHOLE, APPROACH, CLOSE = "Grasp the spot.", "Go to the spot.", "Close the jaws."
OPEN = 0.68
"""Jaws of `bgr_pictures.episode` on their way [rad]."""


def recorded(train: int = 6, val: int = 1, eyes: int = 1) -> recorded_steps.Recorded:
    """The tip goes to the spot (phase 0), the jaws close (phase 1); the right eye sees mirrored."""
    shown = [made.episode(seed) for seed in range(train + val)]
    action = np.concatenate([each.action for each in shown])
    left = np.concatenate([each.views for each in shown])
    views = {LEFT: left, RIGHT: left[:, :, ::-1]}
    return recorded_steps.Recorded(
        np.concatenate([each.state for each in shown]),
        action,
        (action[:, 4] < OPEN).astype(int),
        np.cumsum([0, *(len(each.state) for each in shown)]),
        ["train"] * train + ["val"] * val,
        {key: views[key] for key in (LEFT, RIGHT)[:eyes]},
        {"observation.state": STATE, "action": ACTION},
        [APPROACH, CLOSE],
        {"fps": 20, "robot": "made up", "picture": [120, 120, 3]},
    )


def written(folder: Path, found: recorded_steps.Recorded, **info: Any) -> Path:
    """The same as a LeRobot dataset (v2.1) as `./surg episode export` writes it."""
    import av

    from surg_recording.datasets import ExportOptions, pictures

    column = {
        **{key: {"names": names} for key, names in found.names.items()},
        recorded_steps.PHASE: {"names": None},
        recorded_steps.WHOLE: {"names": None},
    }
    shape = [120, 120, 3]
    facts = {
        "features": {**column, **{key: {"shape": shape} for key in found.views}},
        "splits": {"train": f"0:{len(found.split)}"},
        "fps": 20,
        "robot_type": "made up",
        "chunks_size": 1000,
        "data_path": "data/{episode_chunk:03d}/{episode_index:06d}.parquet",
        "video_path": "videos/{video_key}/{episode_chunk:03d}/{episode_index:06d}.mp4",
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps({**facts, **info}), "utf-8")
    said = [CLOSE, WHOLE, APPROACH]
    rows = [json.dumps({"task_index": n, "task": text}) for n, text in enumerate(said)]
    (folder / "meta" / "tasks.jsonl").write_text("\n".join(rows) + "\n", "utf-8")
    (folder / "data" / "000").mkdir(parents=True)
    for index, part in enumerate(found.episodes("train")):
        place = np.array([2, 0])[found.phase[part]]
        place[-1] = 1  # outside of all phases stands the whole task
        table = {
            "observation.state": list(found.state[part]),
            "action": list(found.action[part]),
            recorded_steps.PHASE: place,
            recorded_steps.WHOLE: np.ones(len(place), int),
        }
        parquet.write_table(pa.table(table), folder / "data" / "000" / f"{index:06d}.parquet")
        for key, views in found.views.items():
            file = folder / "videos" / key / "000" / f"{index:06d}.mp4"
            file.parent.mkdir(parents=True, exist_ok=True)
            frames = (
                av.VideoFrame.from_ndarray(np.ascontiguousarray(view), format="rgb24")
                for view in views[part]
            )
            pictures.encode(frames, file, ExportOptions())
    return folder
