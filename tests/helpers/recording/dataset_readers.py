"""Reads exports with pyarrow, h5py, zarr and PyAV only, frame by frame: none of our code."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pyarrow.parquet as pq
import zarr

from helpers.recording import picture_identity
from helpers.recording.datasets_synthetic import CAMERAS, FRAME_NS

FORMATS = ("lerobot", "lerobot_v30", "robomimic", "act", "diffusion_policy")


@dataclasses.dataclass
class Frame:
    """One exported frame."""

    episode: int
    number: int
    grid_ns: int
    stamps: list[int]
    """True stamp of each camera's picture [ns]."""
    state: np.ndarray
    action: np.ndarray
    pictures: list[np.ndarray]
    """Of each camera, (height, width, 3)."""
    force: np.ndarray | None = None
    """Of the arms; None: it is in no recording."""


def frames(out: Path, format_name: str) -> Iterator[Frame]:
    """All frames of an export in order."""
    return {
        "lerobot": _lerobot_v21,
        "lerobot_v30": _lerobot_v30,
        "robomimic": _robomimic,
        "act": _act,
        "diffusion_policy": _zarr,
    }[format_name](out)


def misplaced(out: Path, format_name: str, recordings: list[int]) -> tuple[int, int]:
    """Number of pictures that are not the one of their time, and of all pictures.

    In a recording without jitter the camera's frame n has the time n · 50 ms, so a picture tells
    its own time. ``recordings`` are the identities of the dataset's episodes, in order.
    """
    wrong = total = 0
    for frame in frames(out, format_name):
        for camera, picture in enumerate(frame.pictures):
            total += 1
            expected = (recordings[frame.episode], camera, frame.grid_ns // FRAME_NS)
            try:
                wrong += dataclasses.astuple(picture_identity.read(picture)) != expected
            except ValueError:
                wrong += 1
    return wrong, total


def decode(path: Path) -> list[np.ndarray]:
    """All pictures of a video."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def _rows(table: Any, shown: list[list[np.ndarray]]) -> Iterator[Frame]:
    for row, *pictures in zip(table.to_pylist(), *shown, strict=True):
        yield Frame(
            row["episode_index"],
            row["frame_index"],
            row["timing.grid_ns"],
            [row[f"timing.{camera}.stamp_ns"] for camera in CAMERAS],
            np.array(row["observation.state"]),
            np.array(row["action"]),
            pictures,
            np.array(row["observation.force"]) if "observation.force" in row else None,
        )


def _video_key(camera: str) -> str:
    return f"observation.images.{camera.replace('_', '.')}"


def _lerobot_v21(out: Path) -> Iterator[Frame]:
    info = json.loads((out / "meta" / "info.json").read_text())
    for episode in range(info["total_episodes"]):
        place = {"episode_chunk": episode // info["chunks_size"], "episode_index": episode}
        table = pq.read_table(out / info["data_path"].format(**place))
        paths = [out / info["video_path"].format(video_key=_video_key(c), **place) for c in CAMERAS]
        yield from _rows(table, [decode(path) for path in paths])


def _lerobot_v30(out: Path) -> Iterator[Frame]:
    info = json.loads((out / "meta" / "info.json").read_text())
    rows = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row in rows:
        place = {k: row[f"data/{k}"] for k in ("chunk_index", "file_index")}
        whole = pq.read_table(out / info["data_path"].format(**place))
        begin = row["dataset_from_index"] - whole.column("index")[0].as_py()
        table = whole.slice(begin, row["length"])
        shown = []
        for camera in CAMERAS:
            key = _video_key(camera)
            place = {k: row[f"videos/{key}/{k}"] for k in ("chunk_index", "file_index")}
            pictures = decode(out / info["video_path"].format(video_key=key, **place))
            first = round(row[f"videos/{key}/from_timestamp"] * info["fps"])
            shown.append(pictures[first : first + row["length"]])
        yield from _rows(table, shown)


def _robomimic(out: Path) -> Iterator[Frame]:
    with h5py.File(out / "demos.hdf5", "r", libver="latest", swmr=True) as root:
        demos = sorted(root["data"], key=lambda name: int(name[5:]))
        for episode, name in enumerate(demos):
            demo = root["data"][name]
            for k in range(demo.attrs["num_samples"]):
                yield Frame(
                    episode,
                    k,
                    int(demo["extra/timing.grid_ns"][k]),
                    [int(demo[f"extra/timing.{c}.stamp_ns"][k]) for c in CAMERAS],
                    demo["obs/state"][k],
                    demo["actions"][k],
                    [demo[f"obs/{c}_image"][k] for c in CAMERAS],
                    demo["obs/force"][k] if "obs/force" in demo else None,
                )


def _act(out: Path) -> Iterator[Frame]:
    for episode in range(len(list(out.glob("episode_*.hdf5")))):
        with h5py.File(out / f"episode_{episode}.hdf5", "r") as root:
            for k in range(len(root["/action"])):
                yield Frame(
                    episode,
                    k,
                    int(root["extra/timing.grid_ns"][k]),
                    [int(root[f"extra/timing.{c}.stamp_ns"][k]) for c in CAMERAS],
                    root["/observations/qpos"][k],
                    root["/action"][k],
                    [root[f"/observations/images/{c}"][k] for c in CAMERAS],
                    root["extra/observation.force"][k]
                    if "extra/observation.force" in root
                    else None,
                )


def _zarr(out: Path) -> Iterator[Frame]:
    root = zarr.open(str(out / "replay.zarr"), mode="r")
    begin = 0
    for episode, end in enumerate(root["meta/episode_ends"][:]):
        for k in range(begin, end):
            yield Frame(
                episode,
                int(k - begin),
                int(root["data/timing.grid_ns"][k]),
                [int(root[f"data/timing.{c}.stamp_ns"][k]) for c in CAMERAS],
                root["data/state"][k],
                root["data/action"][k],
                [root[f"data/{c}"][k] for c in CAMERAS],
                root["data/observation.force"][k] if "data/observation.force" in root else None,
            )
        begin = end
