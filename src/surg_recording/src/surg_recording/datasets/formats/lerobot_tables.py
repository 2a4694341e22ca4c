"""What the LeRobot formats 2.1 and 3.0 share: tables, feature descriptions, checks.

Written with pyarrow and PyAV alone. Facts about the readers, found in lerobot 0.3.3 and 0.4.4:
``timestamp`` is float32; statistics of a column whose name contains "image" must have the shape
(3, 1, 1); a column of shape (1,) is a scalar; names hold no "/".
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from surg_recording.datasets import schema, statistics
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.schema import Feature

DATA = "data.parquet"
COLOURS = "colours.json"
CHUNK = 1000
"""Recordings per folder."""

INDEX_FEATURES: dict[str, dict[str, Any]] = {
    name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index")
}

TASK_TEXT = "annotation.human.action.task_description"
STAGE_TEXT = "annotation.human.action.subtask_description"
"""Columns of GR00T and Open-H: places in ``tasks.jsonl``."""
SUBTASK = "subtask_index"
"""Column of lerobot: place in ``subtasks.parquet``."""

_ARROW = {
    "float32": pa.float32(),
    "float64": pa.float64(),
    "int64": pa.int64(),
    "bool": pa.bool_(),
    "string": pa.string(),
}


def table_of(columns: Mapping[str, npt.NDArray[Any]], features: Iterable[Feature]) -> pa.Table:
    """Columns as an Arrow table: scalars for shape (1,), lists of fixed length otherwise."""
    arrays, names = [], []
    for feature in schema.columns_of(list(features)):
        arrays.append(_array(columns[feature.name], feature.dtype, feature.shape[0]))
        names.append(feature.name)
    return pa.table(arrays, names)


def _array(values: npt.NDArray[Any], dtype: str, length: int) -> pa.Array:
    kind = _ARROW[dtype]
    if dtype == "string":
        return pa.array([str(value) for value in values], kind)
    if length == 1:
        return pa.array(values, kind)
    flat = pa.array(np.ascontiguousarray(values).ravel(), kind)
    return pa.FixedSizeListArray.from_arrays(flat, length)


@dataclasses.dataclass(frozen=True)
class Language:
    """Texts of a dataset with their places, and the columns that hold a row's places."""

    tasks: Mapping[str, int]
    task_columns: tuple[str, ...]
    stages: Mapping[str, int]
    stage_column: str

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """The columns for info.json that are not among ``INDEX_FEATURES``."""
        names = {*self.task_columns, *([self.stage_column] if self.stages else [])}
        entry = {"dtype": "int64", "shape": [1], "names": None}
        return {name: dict(entry) for name in sorted(names - set(INDEX_FEATURES))}

    def places(self, table: pa.Table, instruction: str) -> dict[str, npt.NDArray[Any]]:
        """Column → places of the texts of a recording's rows, (N,)."""
        task = np.full(table.num_rows, self.tasks[instruction])
        columns = dict.fromkeys(self.task_columns, task)
        if self.stages:
            texts = table.column(schema.STAGE).to_pylist()
            columns[self.stage_column] = np.array([self.stages[text] for text in texts])
        return columns


def check_language(table: pa.Table, texts: Sequence[str], column: str, said: str) -> list[str]:
    """An error if a column of places does not lead to the texts of another column."""
    if column not in table.column_names or said not in table.column_names:
        return []
    found = numbers(table, column)
    if not np.isin(found, np.arange(len(texts))).all():
        return [f"column {column} holds a place outside of the {len(texts)} texts"]
    if [texts[place] for place in found] != table.column(said).to_pylist():
        return [f"column {column} does not lead to the texts of {said}"]
    return []


def indexed(
    table: pa.Table, fps: int, episode: int, first: int, language: Mapping[str, npt.NDArray[Any]]
) -> pa.Table:
    """A part's table with the columns of its position in the dataset, and of its texts."""
    for name, values in {**_places(table.num_rows, fps, episode, first), **language}.items():
        kind = pa.float32() if name == "timestamp" else pa.int64()
        table = table.append_column(name, pa.array(values, kind))
    return table


def _places(rows: int, fps: int, episode: int, first: int) -> dict[str, npt.NDArray[Any]]:
    """Time, and positions in the recording and in the dataset, of a recording's rows."""
    k = np.arange(rows)
    return {
        "timestamp": (k / fps).astype(np.float32),
        "frame_index": k,
        "episode_index": np.full(rows, episode),
        "index": first + k,
    }


def numbers(table: pa.Table, name: str) -> npt.NDArray[Any]:
    """A column as (N,) or (N, D)."""
    column = table.column(name).combine_chunks()
    if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1)
    return column.to_numpy(zero_copy_only=False)


def colours_of(part: Part) -> dict[str, tuple[npt.NDArray[np.int64], int]]:
    """Histograms of a part's videos, and the number of frames counted."""
    stated = json.loads((part.folder / COLOURS).read_text("utf-8"))
    return {
        name: (np.array(entry["histogram"], dtype=np.int64), int(entry["sampled"]))
        for name, entry in stated.items()
    }


def stats_of(
    table: pa.Table,
    colours: Mapping[str, tuple[npt.NDArray[np.int64], int]],
    quantiles: bool = False,
) -> dict[str, statistics.Stats]:
    """Statistics of every numeric column and every video."""
    stats = {}
    for field in table.schema:
        if not pa.types.is_string(field.type):
            stats[field.name] = statistics.of_column(numbers(table, field.name), quantiles)
    for name, (histogram, sampled) in colours.items():
        stats[name] = statistics.of_histogram(histogram, sampled, quantiles)
    return stats


def described(features: Sequence[Feature], fps: int) -> dict[str, dict[str, Any]]:
    """The ``features`` of info.json; unit, frame and method stand under ``info``."""
    entries: dict[str, dict[str, Any]] = {}
    for feature in features:
        entry: dict[str, Any] = {
            "dtype": feature.dtype,
            "shape": list(feature.shape),
            "names": list(feature.names),
        }
        if feature.is_video:
            entry["info"] = {
                "video.height": feature.shape[0],
                "video.width": feature.shape[1],
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            }
        else:
            entry["info"] = {
                "units": list(feature.units),
                "frame": feature.frame,
                "method": feature.method,
                "description": feature.text,
                "privileged": feature.privileged,
            }
        entries[feature.name] = entry
    return {**entries, **INDEX_FEATURES}


def info(dataset: Dataset, version: str, language: Language) -> dict[str, Any]:
    """Content of info.json that both versions share."""
    return {
        "codebase_version": version,
        "robot_type": dataset.robot_type,
        "total_episodes": len(dataset.parts),
        "total_frames": dataset.frames,
        "total_tasks": len(language.tasks),
        "chunks_size": CHUNK,
        "fps": dataset.options.fps,
        "action_space": dataset.options.action_space,
        "splits": {name: f"{a}:{b}" for name, (a, b) in dataset.splits.items()},
        "features": {
            **described(dataset.features, dataset.options.fps),
            **language.features,
        },
    }


def write_json(path: Path, value: Any) -> None:
    """Write JSON, creating its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False) + "\n", "utf-8")


def write_lines(path: Path, values: Iterable[Any]) -> None:
    """Write JSON, one value per line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps(value, ensure_ascii=False) + "\n" for value in values]
    path.write_text("".join(lines), "utf-8")


def check_rows(table: pa.Table, stated: Mapping[str, Any], episode: int, first: int) -> list[str]:
    """Errors in the rows of one recording."""
    where, errors = f"recording {episode}", []
    for name, values in _places(table.num_rows, stated["fps"], episode, first).items():
        if name not in table.column_names or not np.array_equal(numbers(table, name), values):
            errors.append(f"{where}: column {name} is not on the grid")
    for name, feature in stated["features"].items():
        if feature["dtype"] == "video":
            continue
        if name not in table.column_names:
            errors.append(f"{where}: no column {name}")
        elif feature["dtype"].startswith("float"):
            values = numbers(table, name)
            shape = () if feature["shape"] == [1] else tuple(feature["shape"])
            if values.shape[1:] != shape:
                errors.append(f"{where}: column {name} has shape {values.shape[1:]}")
            elif not np.isfinite(values).all():
                errors.append(f"{where}: column {name} holds values that are no numbers")
    return errors


def check_splits(stated: Mapping[str, Any]) -> list[str]:
    """Splits must be ranges that follow each other and cover all recordings."""
    ranges = sorted(tuple(map(int, ends.split(":"))) for ends in stated["splits"].values())
    flat = [end for pair in ranges for end in pair]
    good = flat[:1] == [0] and flat[-1:] == [stated["total_episodes"]]
    good = good and all(a == b for a, b in zip(flat[1:-1:2], flat[2::2], strict=False))
    return [] if good else [f"splits {stated['splits']} do not cover {stated['total_episodes']}"]


def check_openness(stated: Mapping[str, Any], report: Report) -> None:
    """Warn of what Open-H requires beyond the format: rate, resolution, names."""
    if stated["fps"] < 20:
        report.warnings.append(f"{stated['fps']} frames per second; Open-H asks for at least 20")
    videos = {k: f for k, f in stated["features"].items() if f["dtype"] == "video"}
    if not videos:
        report.warnings.append("no pictures; Open-H asks for observation.images.endoscope.*")
    for name, feature in videos.items():
        if min(feature["shape"][:2]) < 480:
            size = "x".join(map(str, feature["shape"][1::-1]))
            report.warnings.append(f"{name}: {size}; Open-H asks for at least 480 lines")
    for split in ("val", "test"):
        if split not in stated["splits"]:
            report.warnings.append(
                f"no split '{split}'; too few recordings for the shares asked for"
            )
