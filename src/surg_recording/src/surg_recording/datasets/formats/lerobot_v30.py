"""LeRobot 3.0: many recordings per Parquet file and per video, found by their first frame.

Read by lerobot 0.4 and later. Videos are joined packet by packet, not encoded again.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from surg_recording.calibration import calibration_record
from surg_recording.datasets import pictures, schema, statistics
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.formats import lerobot_tables
from surg_recording.datasets.formats.lerobot_part import LONGEST_S, LeRobotExporter
from surg_recording.datasets.pages import dataset_card, readme
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
TASKS_PATH = "meta/tasks.parquet"
SUBTASKS_PATH = "meta/subtasks.parquet"
DATA_MB, VIDEO_MB = 100, 200
"""A file that would grow over this is followed by another [MiB]."""

_PANDAS_INDEX = "__index_level_0__"


_SAID = {"task_index": schema.INSTRUCTION, lerobot_tables.SUBTASK: schema.STAGE}
"""Column of places → column of the texts that they lead to."""
_TEXTS = {"task_index": TASKS_PATH, lerobot_tables.SUBTASK: SUBTASKS_PATH}


class LeRobotV30(LeRobotExporter):
    """LeRobot 3.0."""

    name = "lerobot_v30"
    title = "LeRobot 3.0 (lerobot 0.4 and later)"

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Join tables and videos into files, write ``meta``."""
        language = _language(dataset)
        rows = _episode_rows(dataset.parts)
        stats = self._write_tables(dataset, rows, language, out)
        videos = schema.videos_of(dataset.features)
        for feature in videos:
            self._join(feature.name, dataset.parts, rows, dataset.options.fps, out)
        for row in rows:
            row.update(_place("meta/episodes", 0))
        path = out / EPISODES_PATH
        path.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(rows), path)
        pq.write_table(texts_table(language.tasks, "task_index"), out / TASKS_PATH)
        if language.stages:
            stages = texts_table(language.stages, lerobot_tables.SUBTASK)
            pq.write_table(stages, out / SUBTASKS_PATH)
        lerobot_tables.write_json(out / "meta" / "stats.json", statistics.to_json(stats))
        stated = lerobot_tables.info(dataset, "v3.0", language)
        stated.update(
            data_files_size_in_mb=DATA_MB,
            video_files_size_in_mb=VIDEO_MB,
            data_path=DATA_PATH,
            video_path=VIDEO_PATH if videos else None,
        )
        lerobot_tables.write_json(out / "meta" / "info.json", stated)
        calibration_record.write([part.about for part in dataset.parts], out / "meta")
        page = readme.page(dataset, "LeRobot 3.0")
        (out / "meta" / "README.md").write_text(page, "utf-8")
        dataset_card.write(dataset, out, "v3.0", page)

    def _write_tables(
        self,
        dataset: Dataset,
        rows: list[dict[str, Any]],
        language: lerobot_tables.Language,
        out: Path,
    ) -> dict[str, statistics.Stats]:
        """Join the tables, note their places and statistics; returns the dataset's statistics."""
        parts = dataset.parts
        files: list[pa.Table] = []
        colours: dict[str, list[Any]] = {}
        sizes = [(part.folder / lerobot_tables.DATA).stat().st_size for part in parts]
        for file, members in enumerate(_groups(sizes, DATA_MB << 20)):
            tables = []
            for index in members:
                part, row = parts[index], rows[index]
                table = pq.read_table(part.folder / lerobot_tables.DATA)
                texts, first = language.places(table, part.instruction), row["dataset_from_index"]
                table = lerobot_tables.indexed(table, dataset.options.fps, index, first, texts)
                histograms = lerobot_tables.colours_of(part)
                for name, entry in histograms.items():
                    colours.setdefault(name, []).append(entry)
                row.update(_place("data", file))
                row.update(_flat(lerobot_tables.stats_of(table, histograms, quantiles=True)))
                tables.append(table)
            path = out / DATA_PATH.format(**_numbers(file))
            path.parent.mkdir(parents=True, exist_ok=True)
            files.append(pa.concat_tables(tables))
            pq.write_table(files[-1], path)
        summed = {
            name: (sum(h for h, _ in entries), sum(n for _, n in entries))
            for name, entries in colours.items()
        }
        return lerobot_tables.stats_of(pa.concat_tables(files), summed, quantiles=True)

    def _join(
        self, name: str, parts: tuple[Part, ...], rows: list[dict[str, Any]], fps: int, out: Path
    ) -> None:
        """Join the videos of one camera, and note in the rows where each recording begins."""
        paths = [part.folder / f"{name}.mp4" for part in parts]
        longest = [part.frames / fps / LONGEST_S for part in parts]
        sizes = [path.stat().st_size / (VIDEO_MB << 20) for path in paths]
        weights = [max(pair) for pair in zip(longest, sizes, strict=True)]
        headers = [pictures.header_of(path) for path in paths]  # one codec setting in each file
        for file, members in enumerate(_groups(weights, 1.0, headers)):
            path = out / VIDEO_PATH.format(video_key=name, **_numbers(file))
            path.parent.mkdir(parents=True, exist_ok=True)
            starts = pictures.join([paths[index] for index in members], path, fps)
            for index, start in zip(members, starts, strict=True):
                rows[index].update(_place(f"videos/{name}", file))
                rows[index][f"videos/{name}/from_timestamp"] = start / fps
                end = start + parts[index].frames
                rows[index][f"videos/{name}/to_timestamp"] = end / fps

    def _validate(self, out: Path, report: Report) -> None:
        stated = read_json(out / "meta" / "info.json")
        stats = read_json(out / "meta" / "stats.json")
        rows = pq.read_table(out / EPISODES_PATH).to_pylist()
        videos = [k for k, f in stated["features"].items() if f["dtype"] == "video"]
        texts = {column: _texts(out / path) for column, path in _TEXTS.items()}
        files: dict[Path, pa.Table] = {}
        ends: dict[Path, float] = {}
        for index, row in enumerate(rows):
            path = out / stated["data_path"].format(**_found(row, "data"))
            if path not in files:
                files[path] = pq.read_table(path)
            here = lerobot_tables.numbers(files[path], "episode_index") == index
            table = files[path].filter(pa.array(here))
            report.errors += lerobot_tables.check_rows(table, stated, index, report.frames)
            for column, said in _SAID.items():
                report.errors += lerobot_tables.check_language(table, texts[column], column, said)
            if row["length"] != table.num_rows or row["dataset_from_index"] != report.frames:
                report.errors.append(f"recording {index}: {table.num_rows} rows, row says {row}")
            for name in videos:
                path = out / stated["video_path"].format(
                    video_key=name, **_found(row, f"videos/{name}")
                )
                if abs(row[f"videos/{name}/from_timestamp"] - ends.get(path, 0.0)) > 1e-9:
                    report.errors.append(
                        f"{name} of recording {index} does not follow the one before"
                    )
                ends[path] = row[f"videos/{name}/to_timestamp"]
                length = ends[path] - row[f"videos/{name}/from_timestamp"]
                if abs(length - row["length"] / stated["fps"]) > 1e-9:
                    report.errors.append(f"{name} of recording {index}: {length} s of video")
            report.recordings += 1
            report.frames += table.num_rows
        for path, end in ends.items():
            facts = pictures.video_facts(path)
            if facts["frames"] != round(end * stated["fps"]) or not facts["on_grid"]:
                report.errors.append(
                    f"{path.relative_to(out)}: {facts['frames']} frames, {end * stated['fps']:.0f}"
                    f" are needed; on the grid: {facts['on_grid']}"
                )
        if (report.recordings, report.frames) != (stated["total_episodes"], stated["total_frames"]):
            report.errors.append("info.json and the tables disagree on recordings or frames")
        computed = lerobot_tables.stats_of(pa.concat_tables(files.values()), {}, quantiles=True)
        report.errors += statistics.differ(stats, computed, list(computed))
        if len(texts["task_index"]) != stated["total_tasks"]:
            report.errors.append("tasks.parquet and info.json disagree")
        report.errors += lerobot_tables.check_splits(stated)
        report.errors += calibration_record.check(out / "meta", stated["total_episodes"])
        lerobot_tables.check_openness(stated, report)
        report.facts.update(splits=stated["splits"], features=list(stated["features"]))


def _episode_rows(parts: Sequence[Part]) -> list[dict[str, Any]]:
    """Index, instruction, length and range of frames of every recording."""
    ends = itertools.accumulate(part.frames for part in parts)
    return [
        {
            "episode_index": index,
            "tasks": [part.instruction],
            "length": part.frames,
            "dataset_from_index": end - part.frames,
            "dataset_to_index": end,
        }
        for index, (part, end) in enumerate(zip(parts, ends, strict=True))
    ]


def _language(dataset: Dataset) -> lerobot_tables.Language:
    """Instructions of tasks and of stages, in two lists as lerobot has them."""
    return lerobot_tables.Language(
        tasks={text: index for index, text in enumerate(dataset.tasks)},
        task_columns=("task_index",),
        stages={text: index for index, text in enumerate(dataset.stages)},
        stage_column=lerobot_tables.SUBTASK,
    )


def texts_table(texts: Mapping[str, int], name: str) -> pa.Table:
    """``tasks.parquet``, ``subtasks.parquet``: the text is the pandas index, as lerobot requires.

    ``name`` is the column of the places. This schema entry marks the index, so writing it does not
    need pandas.
    """
    keys = ("name", "field_name", "pandas_type", "numpy_type", "metadata")
    columns = (
        (name, name, "int64", "int64", None),
        (None, _PANDAS_INDEX, "unicode", "object", None),
    )
    described = {
        "index_columns": [_PANDAS_INDEX],
        "column_indexes": [],
        "columns": [dict(zip(keys, column, strict=True)) for column in columns],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "1.5.3",
    }
    table = pa.table(
        {
            name: pa.array(texts.values(), pa.int64()),
            _PANDAS_INDEX: pa.array(texts.keys(), pa.string()),
        }
    )
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _texts(path: Path) -> list[str]:
    """The texts of ``tasks.parquet`` or ``subtasks.parquet`` by place; none without the file."""
    if not path.exists():
        return []
    name, rows = path.stem.removesuffix("s") + "_index", pq.read_table(path).to_pylist()
    if [row[name] for row in rows] != list(range(len(rows))):
        raise EpisodeError(f"{path}: {name} does not count from 0")
    return [row[_PANDAS_INDEX] for row in rows]


def _groups(
    sizes: list[float] | list[int], limit: float, kinds: list[bytes] | None = None
) -> list[list[int]]:
    """Indices in order, in groups of one kind whose sizes sum to at most the limit (or one)."""
    groups: list[list[int]] = []
    filled = 0.0
    for index, size in enumerate(sizes):
        other = bool(groups) and kinds is not None and kinds[index] != kinds[groups[-1][-1]]
        if not groups or other or filled + size > limit:
            groups.append([])
            filled = 0.0
        groups[-1].append(index)
        filled += size
    return groups


def _numbers(file: int) -> dict[str, int]:
    return {"chunk_index": file // lerobot_tables.CHUNK, "file_index": file % lerobot_tables.CHUNK}


def _place(prefix: str, file: int) -> dict[str, int]:
    return {f"{prefix}/{key}": value for key, value in _numbers(file).items()}


def _found(row: Mapping[str, Any], prefix: str) -> dict[str, int]:
    return {key: int(row[f"{prefix}/{key}"]) for key in ("chunk_index", "file_index")}


def _flat(stats: Mapping[str, statistics.Stats]) -> dict[str, Any]:
    return {
        f"stats/{feature}/{key}": np.asarray(value).tolist()
        for feature, values in stats.items()
        for key, value in values.items()
    }
