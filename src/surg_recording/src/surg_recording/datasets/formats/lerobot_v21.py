"""LeRobot 2.1: one Parquet file and one video per camera for each recording.

Read by lerobot up to 0.3.3, required by Open-H-Embodiment and GR00T. With Open-H's conventions:
``meta/README.md`` filled from the manifests, splits with recovery and failure.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.calibration import calibration_record
from surg_recording.datasets import pictures, schema, statistics
from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.formats import lerobot_tables
from surg_recording.datasets.formats.lerobot_part import LeRobotExporter
from surg_recording.datasets.pages import dataset_card, readme
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError

DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"


_SAID = {
    "task_index": schema.INSTRUCTION,
    lerobot_tables.TASK_TEXT: schema.INSTRUCTION,
    lerobot_tables.STAGE_TEXT: schema.STAGE,
}
"""Column of places → column of the texts that they lead to."""


class LeRobotV21(LeRobotExporter):
    """LeRobot 2.1 with Open-H's conventions."""

    name = "lerobot_v21"
    title = "LeRobot 2.1 (Open-H, GR00T)"

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Number the rows, place the videos, write ``meta``."""
        videos = schema.videos_of(dataset.features)
        language = _language(dataset)
        episodes, stats = [], []
        first = 0
        for index, part in enumerate(dataset.parts):
            place = {"episode_chunk": index // lerobot_tables.CHUNK, "episode_index": index}
            table = pq.read_table(part.folder / lerobot_tables.DATA)
            texts = language.places(table, part.instruction)
            table = lerobot_tables.indexed(table, dataset.options.fps, index, first, texts)
            path = out / DATA_PATH.format(**place)
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(table, path)
            for feature in videos:
                target = out / VIDEO_PATH.format(video_key=feature.name, **place)
                pictures.link_or_copy(part.folder / f"{feature.name}.mp4", target)
            part_stats = lerobot_tables.stats_of(table, lerobot_tables.colours_of(part))
            stats.append({"episode_index": index, "stats": statistics.to_json(part_stats)})
            episodes.append(
                {"episode_index": index, "tasks": [part.instruction], "length": part.frames}
            )
            first += part.frames
        stated = lerobot_tables.info(dataset, "v2.1", language)
        stated.update(
            total_videos=len(videos) * len(dataset.parts),
            total_chunks=(len(dataset.parts) - 1) // lerobot_tables.CHUNK + 1,
            data_path=DATA_PATH,
            video_path=VIDEO_PATH if videos else None,
        )
        meta = out / "meta"
        lerobot_tables.write_json(meta / "info.json", stated)
        named = [{"task_index": index, "task": task} for task, index in language.tasks.items()]
        lerobot_tables.write_lines(meta / "tasks.jsonl", named)
        lerobot_tables.write_json(meta / "modality.json", _modality(dataset, language))
        lerobot_tables.write_lines(meta / "episodes.jsonl", episodes)
        lerobot_tables.write_lines(meta / "episodes_stats.jsonl", stats)
        calibration_record.write([part.about for part in dataset.parts], out / "meta")
        page = readme.page(dataset, "LeRobot 2.1")
        (meta / "README.md").write_text(page, "utf-8")
        dataset_card.write(dataset, out, "v2.1", page)

    def _validate(self, out: Path, report: Report) -> None:
        stated = read_json(out / "meta" / "info.json")
        episodes = _lines(out / "meta" / "episodes.jsonl")
        stats = _lines(out / "meta" / "episodes_stats.jsonl")
        tasks = _lines(out / "meta" / "tasks.jsonl")
        texts = [task["task"] for task in tasks]
        videos = [k for k, f in stated["features"].items() if f["dtype"] == "video"]
        if not len(episodes) == len(stats) == stated["total_episodes"]:
            report.errors.append("info.json, episodes.jsonl and episodes_stats.jsonl disagree")
        if len(tasks) != stated["total_tasks"]:
            report.errors.append("info.json and tasks.jsonl disagree")
        for index, entry in enumerate(episodes):
            place = {"episode_chunk": index // stated["chunks_size"], "episode_index": index}
            table = pq.read_table(out / stated["data_path"].format(**place))
            report.errors += lerobot_tables.check_rows(table, stated, index, report.frames)
            for column, said in _SAID.items():
                report.errors += lerobot_tables.check_language(table, texts, column, said)
            if table.num_rows != entry["length"]:
                report.errors.append(
                    f"recording {index}: {table.num_rows} rows, not {entry['length']}"
                )
            computed = lerobot_tables.stats_of(table, {})
            report.errors += statistics.differ(stats[index]["stats"], computed, list(computed))
            for name in videos:
                path = out / stated["video_path"].format(video_key=name, **place)
                facts = pictures.video_facts(path)
                size = [facts["height"], facts["width"], 3]
                if size != stated["features"][name]["shape"]:
                    report.errors.append(f"{path.name}: size {size}")
                if facts["frames"] != table.num_rows or not facts["on_grid"]:
                    report.errors.append(
                        f"{name} of recording {index}: {facts['frames']} frames for"
                        f" {table.num_rows} rows, on the grid: {facts['on_grid']}"
                    )
            report.recordings += 1
            report.frames += table.num_rows
        if report.frames != stated["total_frames"]:
            report.errors.append(f"{report.frames} rows, info.json says {stated['total_frames']}")
        report.errors += lerobot_tables.check_splits(stated)
        report.errors += calibration_record.check(out / "meta", stated["total_episodes"])
        text = (out / "meta" / "README.md").read_text("utf-8")
        report.errors += readme.missing_sections(text)
        lerobot_tables.check_openness(stated, report)
        report.facts.update(splits=stated["splits"], features=list(stated["features"]))


def _language(dataset: Dataset) -> lerobot_tables.Language:
    """Instructions of tasks and stages in one list, as GR00T has them."""
    texts = dict.fromkeys([*dataset.tasks, *dataset.stages])
    places = {text: index for index, text in enumerate(texts)}
    return lerobot_tables.Language(
        tasks=places,
        task_columns=("task_index", lerobot_tables.TASK_TEXT),
        stages=places if dataset.stages else {},
        stage_column=lerobot_tables.STAGE_TEXT,
    )


def _modality(dataset: Dataset, language: lerobot_tables.Language) -> dict[str, Any]:
    """``modality.json`` of GR00T: which numbers of state and action belong to which arm."""
    named = {feature.name: feature for feature in dataset.features}
    vectors = {
        key: _by_arm(named[name].names)
        for key, name in (("state", STATE_KEY), ("action", ACTION_KEY))
        if name in named
    }
    return {
        **vectors,
        "video": {
            feature.camera: {"original_key": feature.name}
            for feature in schema.videos_of(dataset.features)
        },
        "annotation": {name.removeprefix("annotation."): {} for name in sorted(language.features)},
    }


def _by_arm(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Arm → the range of its numbers; a name is ``PSM1/tip_x``."""
    owners = [name.partition("/")[0] for name in names]
    return {
        arm: {"start": owners.index(arm), "end": len(owners) - owners[::-1].index(arm)}
        for arm in dict.fromkeys(owners)
    }


def _lines(path: Path) -> list[Any]:
    try:
        return [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    except (OSError, ValueError) as problem:
        raise EpisodeError(f"{path}: {problem}") from None
