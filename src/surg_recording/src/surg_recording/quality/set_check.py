"""Checks a LeRobot data set of anybody: its description, each episode, episodes against another."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_reader import stored_pictures
from surg_recording.imports.lerobot_set import LeRobotData, names_of
from surg_recording.quality import picture_checks, row_checks
from surg_recording.quality.set_rows import (
    WHOLE,
    Array,
    EpisodePictures,
    EpisodeRows,
    Finding,
)
from surg_recording.recording_errors import EpisodeError
from surg_recording.video.image_motion import HEIGHT, WIDTH

NUMBERS = ("float32", "float64", "int64", "int32")
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")

Report = Callable[[float, str], None]


def check(root: Path, report: Report = lambda share, words: None) -> list[Finding]:
    """All that is wrong with a set, in the order of its episodes.

    Args:
        root: Its folder.
        report: Told of the progress, 0 to 1.

    Raises:
        EpisodeError: There is no data set of a version that is known.
    """
    data = LeRobotData(root)
    found: list[Finding] = []
    known: list[EpisodeRows] = []
    for number in data.numbers:
        report(0.2 * number / max(data.count, 1), f"rows of episode {number}")
        try:
            known.append(rows_of(data, number))
        except EpisodeError as problem:
            found.append(Finding(number, "cannot be read", "data", str(problem)))
    fps, ranges = float(data.fps), _ranges(known)
    for place, rows in enumerate(known):
        report(0.2 + 0.8 * place / len(known), f"episode {rows.number}")
        found += row_checks.findings(rows, fps, ranges)
        ordered = bool((np.diff(rows.times) > 0).all())  # else no picture has a row of its own
        for camera in data.cameras if ordered else ():
            try:
                seen = pictures_of(data, rows, camera)
                found += picture_checks.findings(rows, seen, fps)
            except EpisodeError as problem:
                found.append(Finding(rows.number, "cannot be read", camera, str(problem)))
    found += _of_the_set(data, known)
    return sorted(found, key=lambda each: each.episode)


def rows_of(data: LeRobotData, number: int) -> EpisodeRows:
    """The numbers of an episode.

    Raises:
        EpisodeError: They cannot be read, or have another width than the set states.
    """
    table = data.table(number)
    columns = {}
    for name, feature in data.features.items():
        if name in BOOKKEEPING or feature.get("dtype") not in NUMBERS:
            continue
        if name not in table.column_names:
            raise EpisodeError(f"{data.root}: episode {number} has no column {name}")
        width = int(np.prod(feature.get("shape") or [1]))
        columns[name] = _values(table.column(name).to_pylist(), width, f"{number}: {name}")
    named = "timestamp" in table.column_names
    frames = np.array(table.column("frame_index").to_pylist(), np.int64)
    times = table.column("timestamp").to_pylist() if named else frames / float(data.fps)
    names = {name: names_of(data.features[name]) for name in columns}
    return EpisodeRows(
        number, np.array(times, float), frames, columns, names, data.instructions(table)
    )


def _values(stored: list[Any], width: int, where: str) -> Array:
    """A column as (T, width); NaN where it is empty."""
    full = np.full((len(stored), width), np.nan)
    for row, value in enumerate(stored):
        flat = np.ravel(np.array(value, dtype=float)) if value is not None else full[row]
        if len(flat) != width:
            raise EpisodeError(f"episode {where} has {len(flat)} values in row {row}, not {width}")
        full[row] = flat
    return full


def pictures_of(data: LeRobotData, rows: EpisodeRows, camera: str) -> EpisodePictures:
    """The small pictures of a camera.

    Raises:
        EpisodeError: Its video cannot be read.
    """
    places, small = [], []
    ledger = Ledger()  # what is missing is counted by its rows
    if data.features[camera].get("dtype") == "video":
        pictures = data.pictures(rows.number, camera, rows.times, camera, ledger)
    else:
        stored = stored_pictures(data, data.table(rows.number), camera, camera, ledger)
        pictures = ((row, _decoded(found.data, camera)) for row, found in stored)
    for row, image in pictures:
        places.append(row)
        small.append(_small(image))
    kept = np.array(small, np.uint8).reshape(-1, HEIGHT, WIDTH)
    return EpisodePictures(camera, np.array(places, np.int64), kept)


def _small(image: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
    return frame.reformat(WIDTH, HEIGHT, "gray", interpolation="AREA").to_ndarray()


def _decoded(data: bytes, camera: str) -> np.ndarray[Any, Any]:
    try:
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
    except OSError as problem:
        raise EpisodeError(f"{camera}: a picture cannot be decoded ({problem})") from None


def _ranges(known: list[EpisodeRows]) -> row_checks.Ranges:
    """What each column covers in the set, without its outermost thousandths."""
    ranges = {}
    for feature in {name for rows in known for name in rows.columns}:
        values = np.vstack([rows.columns[feature] for rows in known])
        values = np.where(np.isfinite(values), values, np.nan)
        empty = ~np.isfinite(values).any(axis=0)
        values[:, empty] = 0.0
        low, high = np.nanquantile(values, [0.001, 0.999], axis=0)
        ranges[feature] = (low, high)
    return ranges


def _of_the_set(data: LeRobotData, known: list[EpisodeRows]) -> Iterator[Finding]:
    total, stated = sum(len(rows.times) for rows in known), data.info.get("total_frames")
    if len(known) == data.count and isinstance(stated, int) and stated != total:
        what = f"total_frames is {stated}, the episodes have {total} rows"
        yield Finding(WHOLE, "counts differ", "meta/info.json", what)
    part = _parts(data.info.get("splits") or {})
    first: dict[bytes, int] = {}
    for rows in known:
        key = _content(rows)
        before = first.setdefault(key, rows.number)
        if before == rows.number:
            continue
        yield Finding(rows.number, "a duplicate", "rows", f"the same motion as episode {before}")
        if (mine := part(rows.number)) != (other := part(before)):
            what = f"episode {before} of {other!r} is in {mine!r} too"
            yield Finding(rows.number, "leakage between splits", "splits", what)


def _content(rows: EpisodeRows) -> bytes:
    digest = hashlib.sha256()
    for feature in (STATE_KEY, ACTION_KEY):
        values = rows.columns.get(feature, np.zeros(0))
        digest.update(np.round(values, 6).astype(np.float32).tobytes())
    return digest.digest()


def _parts(splits: Any) -> Callable[[int], str]:
    """The split of an episode: LeRobot states ranges such as ``0:80``."""
    ranges = {}
    for name, words in splits.items() if isinstance(splits, dict) else ():
        low, found, high = str(words).partition(":")
        if found and low.isdecimal() and high.isdecimal():
            ranges[str(name)] = range(int(low), int(high))
    return lambda number: next((name for name, each in ranges.items() if number in each), "")
