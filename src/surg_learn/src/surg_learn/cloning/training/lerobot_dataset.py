"""A LeRobot dataset (v2.1) of `./surg episode export` for the trainers: episodes, targets, scales.

PyAV reads its videos, small as the networks take them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from surg_learn.cloning.small_pictures import check_size, views_of

Array = np.ndarray
Progress = Callable[[float, str], None]
"""Called with the finished share, 0 to 1, and a note."""
RATE = 20
"""Of the steps that a policy answers with [Hz]."""
E = TypeVar("E")
"""One recording, in a trainer's own type."""


@dataclass
class Dataset(Generic[E]):
    """Episodes by split, and the column names of each feature."""

    episodes: dict[str, list[E]]
    names: dict[str, list[str]]
    about: dict[str, Any]


def facts(folder: Path, needed: Sequence[str]) -> dict[str, Any]:
    """Metadata of a dataset (`meta/info.json`).

    Args:
        folder: Of the dataset.
        needed: Required features.

    Raises:
        ValueError: The folder is no dataset of version 2, a feature is missing, the actions are not
            absolute, or the rate is another than the policies'.
    """
    try:
        info: dict[str, Any] = json.loads((folder / "meta" / "info.json").read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder}: no LeRobot dataset (meta/info.json: {error})") from None
    version = str(info.get("codebase_version", "v2"))
    if not version.startswith("v2"):
        raise ValueError(
            f"{folder}: a LeRobot dataset of version {version} (meta/info.json); allowed: v2.1. "
            "Export it again with --format lerobot"
        )
    missing = [name for name in needed if name not in info["features"]]
    if missing:
        raise ValueError(
            f"{folder}: the dataset has no {', '.join(missing)}; export it without --drop"
        )
    space = info.get("action_space", "absolute")
    if space != "absolute":
        raise ValueError(
            f"{folder}: its action space is {space!r} (meta/info.json); allowed: 'absolute'. "
            "Export it again without --action-space"
        )
    fps = info.get("fps", 0)
    if fps != RATE:
        raise ValueError(
            f"{folder}: its steps come at {fps:g} Hz; allowed: {RATE}, at which a policy acts. "
            "Export it again without --fps"
        )
    return info


def recordings(
    folder: Path,
    info: dict[str, Any],
    names: Sequence[str],
    pictures: Sequence[str] = (),
    progress: Progress = lambda part, note: None,
) -> Iterator[tuple[str, dict[str, Array]]]:
    """Split and arrays of every episode: features (T, n), then pictures (T, SIDE, SIDE, 3), uint8.

    Args:
        folder: Of the dataset.
        info: Of `facts`.
        names: Of the features.
        pictures: Keys of the pictures.
        progress: Is told how far it is.

    Raises:
        ValueError: The pictures do not fit a network, or the rows.
    """
    import pyarrow.parquet

    for key in pictures:
        check_size(folder, key, info["features"][key]["shape"])
    ends = [(split, map(int, ends.split(":"))) for split, ends in info["splits"].items()]
    found = [(split, index) for split, (first, last) in ends for index in range(first, last)]
    for n, (split, index) in enumerate(found):
        progress(n / len(found), f"episode {n + 1} of {len(found)}")
        file = _file_of(folder, info, "data_path", index)
        table = pyarrow.parquet.read_table(file, columns=list(names))
        arrays = {name: np.stack(table[name].to_numpy()).astype(np.float64) for name in names}
        for key in pictures:
            arrays[key] = views_of(_file_of(folder, info, "video_path", index, video_key=key))
            if len(arrays[key]) != table.num_rows:
                raise ValueError(
                    f"{folder}: episode {index} has {len(arrays[key])} pictures of {key} and "
                    f"{table.num_rows} rows"
                )
        yield split, arrays


def _file_of(folder: Path, info: dict[str, Any], path: str, index: int, **more: str) -> Path:
    """A file of an episode, by the key of its path pattern, such as ``data_path``."""
    chunk = index // info["chunks_size"]
    name: str = info[path].format(episode_chunk=chunk, episode_index=index, **more)
    return folder / name


def names_of(info: dict[str, Any], features: Sequence[str]) -> dict[str, list[str]]:
    """Column names of features."""
    return {name: flat_names(info["features"][name]["names"]) for name in features}


def flat_names(names: Any) -> list[str]:
    """Column names of a feature; the format allows a list, or a dictionary with one."""
    return list(next(iter(names.values()))) if isinstance(names, dict) else list(names)


def last_commands(state: Array, action: Array, held: Any) -> Array:
    """Tip and roll of the last command at each step, (T, 4); at the first step, the set-point.

    Args:
        state: (T, n) of an episode.
        action: (T, 5)
        held: Columns of the state with the set-point of tip and roll.
    """
    return np.vstack([state[:1, held], action[:-1, :4]])


def targets_of(action: Array, last: Array, chunk: int) -> Array:
    """Targets of the prediction at each step, (T, chunk, 5).

    They are relative to the last command, except for the jaw. After the end the last action holds.

    Args:
        action: (T, 5) of an episode.
        last: (T, 4) of `last_commands`.
        chunk: Actions ahead.
    """
    row = np.arange(len(action))
    targets = action[np.minimum(row[:, None] + np.arange(chunk), len(row) - 1)]
    targets[:, :, :4] -= last[:, None, :]
    return targets


def scales_of(inputs: Array, targets: Array) -> dict[str, Array]:
    """Mean and standard deviation of inputs (N, F) and flat targets (N, K * 5)."""
    flat = targets.reshape(len(targets), -1)
    return {
        "input_mean": inputs.mean(axis=0),
        "input_std": np.maximum(inputs.std(axis=0), 1e-3),
        "output_mean": flat.mean(axis=0),
        "output_std": np.maximum(flat.std(axis=0), 1e-4),
    }


def jaw_range(targets: Array) -> Array:
    """Smallest and largest jaw angle of targets (N, K, 5)."""
    return np.array([targets[:, :, 4].min(), targets[:, :, 4].max()])


def normalised(scales: Mapping[str, Array], inputs: Array, targets: Array) -> tuple[Array, Array]:
    """Inputs (N, F) and flat targets (N, K * 5) with mean 0 and standard deviation 1, float32."""
    x = (inputs - scales["input_mean"]) / scales["input_std"]
    y = (targets.reshape(len(x), -1) - scales["output_mean"]) / scales["output_std"]
    return x.astype(np.float32), y.astype(np.float32)
