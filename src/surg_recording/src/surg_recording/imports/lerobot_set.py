"""The files of a LeRobot data set 2.0, 2.1 or 3.0: description, rows, instructions, pictures."""

from __future__ import annotations

import json
import re
import string
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from surg_recording.datasets import schema
from surg_recording.file_io import read_json, regular_file
from surg_recording.imports.ledger import Ledger
from surg_recording.recording_errors import EpisodeError, telling
from surg_recording.video.colours import Colours, rotation_of

VERSIONS = ("v2.0", "v2.1", "v3.0")
LARGEST_DENOMINATOR = 1001
"""Of a rate: those of television are 24000, 30000 and 60000 over 1001."""
FASTEST_HZ = 1000
NOT_STATED = "not stated"
CURE = "cannot be read; download it again"
MOST_COLUMNS = 10_000
"""Of a table: hands with tactile skin have some hundred."""
_TEXTS = ("task", "__index_level_0__")
"""Columns of ``meta/tasks`` that hold the instruction where there are others too."""
_PLACES = {"episode_index", "episode_chunk", "chunk_index", "file_index", "video_key"}
_WIDTH = re.compile(r"(0?[0-9]d)?")
"""How a template may write a number."""

Times = npt.NDArray[np.float64]


class LeRobotData:
    """A data set on the disk."""

    def __init__(self, root: Path) -> None:
        """Read its description; an EpisodeError if it is none, or of another version."""
        self.root = root
        if not (root / "meta" / "info.json").exists():
            raise EpisodeError(f"{root}: no LeRobot data set (meta/info.json is missing)")
        with telling(root, "no LeRobot data set"):
            self.info: dict[str, Any] = read_json(root / "meta" / "info.json")
            self.fps, self.count = rate(self.info["fps"]), int(self.info["total_episodes"])
            self.features: dict[str, dict[str, Any]] = dict(self.info["features"])
            self.version = str(self.info["codebase_version"])
            self._chunk = max(int(self.info.get("chunks_size", 1000)), 1)
        if self.version not in VERSIONS:
            raise EpisodeError(
                f"{root}/meta/info.json: codebase_version is {self.version!r}; this version reads"
                f" {', '.join(VERSIONS)}"
            )
        self._rows = _episode_rows(root)
        self.numbers = sorted(self._rows)
        if not self._rows and not self.count:
            raise EpisodeError(
                f"{root}: holds no episode; looked for meta/episodes.jsonl and"
                " meta/episodes/**/*.parquet"
            )
        if len(self._rows) != self.count:
            raise EpisodeError(
                f"{root}/meta/info.json: total_episodes is {self.count}, meta/episodes lists"
                f" {len(self._rows)}. Download meta again"
            )
        kinds = {name: feature.get("dtype") for name, feature in self.features.items()}
        self.cameras = [name for name, kind in kinds.items() if kind in ("video", "image")]
        self.depth_maps = [name for name in self.cameras if _is_depth_map(self.features[name])]
        self._tasks = _tasks(root)

    def table(self, episode: int) -> Any:
        """The rows of an episode, in the order of ``frame_index``.

        Raises:
            EpisodeError: They cannot be read, or are not as many as the data set says.
        """
        if episode not in self._rows:
            known = f"its {self.count} are numbered {self.numbers[0]} to {self.numbers[-1]}"
            raise EpisodeError(f"{self.root}: there is no episode {episode}; {known}")
        path = self._path("data_path", episode, "data")
        with telling(path, CURE):
            _columns(path)
            table = pq.read_table(path, filters=[("episode_index", "=", episode)])
            table = table.sort_by("frame_index")
        stated = self._rows[episode].get("length", table.num_rows)
        if not table.num_rows or table.num_rows != stated:
            raise EpisodeError(
                f"{path}: holds {table.num_rows} rows of episode {episode}; meta/episodes says"
                f" {stated}. Download the file again, or write the data set again"
            )
        return table

    def instructions(self, table: Any) -> list[str]:
        """What was to be done in each row."""
        if schema.INSTRUCTION in table.column_names:
            return [str(text) for text in table.column(schema.INSTRUCTION).to_pylist()]
        if "task_index" not in table.column_names:
            row = self._rows[table.column("episode_index")[0].as_py()]
            stated = list(row.get("tasks") or [])
            return [stated[0] if len(stated) == 1 else NOT_STATED] * table.num_rows
        return [self._tasks.get(i, NOT_STATED) for i in table.column("task_index").to_pylist()]

    def pictures(
        self, episode: int, video: str, times: Times, stream: str, ledger: Ledger
    ) -> Iterator[tuple[int, npt.NDArray[np.uint8]]]:
        """Row and picture (height, width, 3) of each row whose picture the video has.

        Args:
            episode: Its number.
            video: The feature.
            times: Of the rows since the episode's start, increasing [s].
            stream: For the ledger, which counts rows without a picture.
            ledger: Of the import.
        """
        path = self._path("video_path", episode, f"videos/{video}", video_key=video)
        begin = self._rows[episode].get(f"videos/{video}/from_timestamp")
        if begin is None and self.version == VERSIONS[-1]:
            raise EpisodeError(
                f"{self.root}/meta/episodes: videos/{video}/from_timestamp of episode {episode} is"
                " missing, so its place in the video is unknown. Download meta again"
            )
        wanted = times + float(begin or 0.0)
        near = float(1 / self.fps) / 4  # further off, the next picture could be meant
        at, unused, last = 0, 0, 0.0
        with telling(path, "cannot be decoded; download it again"):
            colours = Colours(rotation_of(path))
            with av.open(str(path)) as container:
                shown = container.streams.video[0]
                container.seek(max(0, int((wanted[0] - near) / shown.time_base)), stream=shown)
                for frame in container.decode(shown):
                    last = float(frame.pts * shown.time_base)
                    while at < len(wanted) and wanted[at] < last - near:
                        at += 1
                        ledger.drop(stream, "rows for whose time the video has no picture")
                    if at == len(wanted):
                        break
                    used = at
                    if at == 0 and frame.format.components[0].bits > 8:
                        ledger.converted[stream] = f"{frame.format.name} to 8 bits"
                    while at < len(wanted) and abs(wanted[at] - last) <= near:
                        yield at, colours(frame)
                        at += 1
                    unused += at == used and last > wanted[0]
        reason = f"rows behind the end of the video ({last:.3f} s)"
        ledger.drop(stream, reason, len(wanted) - at)
        if unused:
            ledger.assume(f"{stream}: {unused} pictures of the video belong to no row")

    def _path(self, key: str, episode: int, prefix: str, **further: str) -> Path:
        """A file of an episode, inside the data set."""
        template = self.info.get(key)
        parsed = list(string.Formatter().parse(str(template)))
        fields = {str(name) for _, name, *_ in parsed if name}
        plain = all(_WIDTH.fullmatch(width or "") for _, _, width, _ in parsed)
        row = self._rows[episode]
        places: dict[str, Any] = {
            "episode_index": episode,
            "episode_chunk": episode // self._chunk,
            **{k: int(row[f"{prefix}/{k}"]) for k in _PLACES if f"{prefix}/{k}" in row},
            **further,
        }
        if not isinstance(template, str) or not fields <= set(places) or not plain:
            raise EpisodeError(
                f"{self.root}/meta/info.json: {key} is {template!r}; it may name"
                f" {', '.join(sorted(places))}"
            )
        name = Path(template.format(**places))
        if name.is_absolute() or ".." in name.parts:
            raise EpisodeError(f"{self.root}/meta/info.json: {key} leads out of the data set")
        return regular_file(self.root / name)


def rate(stated: Any) -> Fraction:
    """A rate as a rational number [1/s]; 29.97 is 2997/100, 29.97002997 is 30000/1001.

    Raises:
        ValueError: It is no rate.
    """
    found = Fraction(str(float(stated))).limit_denominator(LARGEST_DENOMINATOR)
    if not 0 < found <= FASTEST_HZ:
        raise ValueError(f"fps: {stated!r}; allowed: above 0, to {FASTEST_HZ}")
    return found


def _lines(file: Path) -> list[dict[str, Any]]:
    """The rows of a JSON-lines file; none without one."""
    if not file.is_file():
        return []
    with telling(file, CURE):
        return [json.loads(line) for line in file.read_text("utf-8").splitlines() if line.strip()]


def _parquet(files: Sequence[Path]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for file in files:
        with telling(regular_file(file), CURE):
            names = [n for n in _columns(file) if not n.startswith("stats/")]
            rows += pq.read_table(file, columns=names).to_pylist()
    return rows


def _columns(file: Path) -> list[str]:
    """The columns of a table; so many that to read them would take minutes are refused."""
    names = [str(name) for name in pq.read_schema(file).names]
    if len(names) > MOST_COLUMNS:
        raise EpisodeError(f"{file}: {len(names)} columns; allowed: {MOST_COLUMNS}")
    return names


def _episode_rows(root: Path) -> dict[int, dict[str, Any]]:
    """What ``meta`` says of each episode."""
    rows = _lines(root / "meta" / "episodes.jsonl")
    rows += _parquet(sorted((root / "meta" / "episodes").rglob("*.parquet")))
    with telling(root / "meta" / "episodes", CURE):
        return {int(row["episode_index"]): row for row in rows}


def _tasks(root: Path) -> dict[int, str]:
    """Instructions by number; pandas calls their column ``__index_level_0__`` or its own name."""
    rows = _lines(root / "meta" / "tasks.jsonl")
    file = root / "meta" / "tasks.parquet"
    rows += _parquet([file] if file.is_file() else [])
    with telling(root / "meta" / "tasks", CURE):
        return {
            int(row.pop("task_index")): str(next(row[k] for k in (*_TEXTS, *row) if k in row))
            for row in rows
        }


def _is_depth_map(feature: Mapping[str, Any]) -> bool:
    about = feature.get("info") or feature.get("video_info") or {}
    return bool(about.get("is_depth_map") or about.get("video.is_depth_map"))


def names_of(feature: Mapping[str, Any]) -> list[str]:
    """Names of a feature's columns, in their order; none where they are not stated.

    A list; a map from name to number; or groups with a list each, whose names are
    ``<group>/<name>`` if there is more than one.
    """
    names, width = feature.get("names"), int((feature.get("shape") or [1])[0])
    if isinstance(names, Mapping):
        if all(isinstance(place, int) for place in names.values()):
            names = sorted(names, key=names.__getitem__)
        else:
            prefixes = {g: f"{g}/" if len(names) > 1 else "" for g in names}
            names = [f"{prefixes[g]}{name}" for g, each in names.items() for name in each]
    found = [str(name) for name in names or ()]
    return found if len(found) == width else []
