"""Completes an episode folder: truncates broken ends, counts rows, writes the manifest.

The recorder and the recovery of a killed recorder's folder end with this.
"""

from __future__ import annotations

import array
import csv
import datetime
import json
import math
import mmap
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.episode import damaged
from surg_recording.episode.episode_reader import MANIFEST, TOPICS
from surg_recording.episode.integrity import HASH, VIDEO_HASH
from surg_recording.file_io import file_hash, read_json
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

_TICKED = ("cycle_", "ground_truth_")
"""Tables that have a row for every tick."""


def complete(
    folder: Path, manifest: dict[str, Any], drops: Mapping[str, int], reason: str | None
) -> None:
    """Repair every file, describe it in the manifest, and write that; may raise OSError.

    ``drops`` counts what was received but not written; ``reason`` states why the recording is
    incomplete (None: no reason known). The manifest gets ``tables``, ``videos``, ``outcome``, ….
    """
    for leftover in [*folder.glob("*.tmp"), *folder.glob(f"{TOPICS}/*.tmp")]:
        damaged.set_aside(leftover)
    reasons = [reason] if reason else []
    videos = _videos(folder, drops, reasons)
    tables = _tables(folder, videos, drops, reasons)
    _name_what_is_lost(manifest, tables, videos, reasons)
    manifest.setdefault("topics", _topics(tables))
    manifest.update(
        tables=tables,
        videos=videos,
        outcome="incomplete" if reasons else "complete",
        reason="; ".join(reasons) or None,
        finished=utc_now(),
    )
    write_json(folder / MANIFEST, manifest)


def _name_what_is_lost(
    manifest: Mapping[str, Any],
    tables: Mapping[str, Any],
    videos: Mapping[str, Any],
    reasons: list[str],
) -> None:
    """Add a reason per camera and arm of which nothing is left, unless one says so already."""
    told = "; ".join(reasons)
    lost = [(c, "no frame") for c in manifest.get("cameras") or () if c not in videos]
    lost += [
        (a, "no control cycle") for a in manifest.get("arms") or () if f"cycle_{a}" not in tables
    ]
    reasons += [f"{name}: {what} is left" for name, what in lost if f"{name}: " not in told]


def _videos(folder: Path, drops: Mapping[str, int], reasons: list[str]) -> dict[str, Any]:
    """Repair and describe the videos; those without any frame are set aside."""
    videos: dict[str, Any] = {}
    for path in sorted(folder.glob("*.mp4")):
        sidecar = path.with_suffix(".csv")
        if not damaged.is_regular(path):
            reasons.append(f"{path.name}: is no file")
            continue
        if not sidecar.exists():
            reasons.append(f"{path.name}: its sidecar is missing, so its frames have no stamps")
            continue
        if not damaged.is_regular(sidecar):
            reasons.append(f"{sidecar.name}: is no file, so its frames have no stamps")
            continue
        readable = video_file.has_frames(path)
        frames = video_file.mend(path, sidecar, reasons) if readable else 0
        if not frames:
            kept = [name for name in map(damaged.set_aside, (path, sidecar)) if name]
            where = f"; kept as {', '.join(kept)}" if kept else ""
            what = "no stamp is left of its frames" if readable else "no frame can be read"
            reasons.append(f"{path.stem}: {what}{where}")
            continue
        entry = describe_table(sidecar)
        entry["frames"] = entry.pop("rows")
        entry[VIDEO_HASH] = file_hash(path)
        camera, part, _ = path.stem.partition(".")
        entry["dropped"] = 0 if part else int(drops.get(camera, 0))
        if part:
            entry["part_of"] = camera
        videos[path.stem] = {"file": path.name, "sidecar": sidecar.name, **entry}
    return videos


def _tables(
    folder: Path, videos: Mapping[str, Any], drops: Mapping[str, int], reasons: list[str]
) -> dict[str, Any]:
    """Repair and describe the tables; a file without even a header is set aside."""
    tables: dict[str, Any] = {}
    for path in [*sorted(folder.glob("*.csv")), *sorted(folder.glob(f"{TOPICS}/*.csv"))]:
        name = str(path.relative_to(folder).with_suffix(""))
        if name in videos or os.path.lexists(path.with_suffix(".mp4")):
            continue
        if not damaged.is_regular(path):
            reasons.append(f"{name}.csv: is no file")
            continue
        if not _repaired(path, reasons):
            continue
        entry: dict[str, Any] = {"file": f"{name}.csv", **describe_table(path)}
        entry["dropped"] = int(drops.get(name, 0))
        about = path.with_suffix(".json")
        if path.parent != folder and about.exists():
            entry.update(_about(about))
        if "problem" in entry:
            reasons.append(f"{name}: {entry['problem']}")
        missing = entry.get("missing_ticks")
        if missing and name.startswith(_TICKED):
            reasons.append(f"{name}: {missing} ticks missing")
        tables[name] = entry
    return tables


def _topics(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Topics of the tables below ``topics/``, for a recorder that was killed."""
    topics: dict[str, Any] = {}
    for name, entry in tables.items():
        if "topic" in entry:
            of = topics.setdefault(entry["topic"], {"messages": 0, "tables": []})
            of["type"] = entry.get("type")
            of["messages"] += entry["rows"]
            of["tables"].append(name)
    return topics


def _about(path: Path) -> dict[str, Any]:
    """Topic, type and kinds that the recorder noted when it opened a topic's table."""
    try:
        about = read_json(path)
    except EpisodeError:
        return {}
    kinds = {"topic": str, "type": str, "kinds": dict}
    about = about if isinstance(about, dict) else {}
    return {key: about[key] for key, kind in kinds.items() if isinstance(about.get(key), kind)}


def _repaired(path: Path, reasons: list[str]) -> bool:
    """Cut the broken end of a table; False if not even its header is left."""
    size, end = path.stat().st_size, whole_lines(path)
    if end:
        if end < size:
            reasons.append(damaged.cut_words(path, size - end, damaged.cut(path, end)))
        return True
    if kept := damaged.set_aside(path):
        reasons.append(f"{path.name}: no line of it is whole; kept as {kept}")
    return False


def whole_lines(path: Path) -> int:
    """Size of a CSV file up to its last complete line [bytes].

    A kill or a full disk can only break the last line, because lines are appended. A machine that
    went down may leave zeros at the end; a line never holds one.
    """
    size = path.stat().st_size
    if not size:
        return 0
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        zero = data.find(b"\0")
        return data.rfind(b"\n", 0, size if zero < 0 else zero) + 1


def describe_table(path: Path) -> dict[str, Any]:
    """Hash, rows, rate and gaps of a CSV file, from its stamps and ticks.

    ``rate_hz`` is rows − 1 over the time from first to last stamp (of reception if there are none).
    A gap is a distance above 1.5 times the median; ``missing_ticks`` counts ticks between the first
    and the last without a row. ``problem``: the recorder did not write this file.
    """
    with open(path, encoding="utf-8", errors="replace", newline="") as file:
        header = _header(file.readline())
        wanted = [header.index(name) for name in ("stamp_ns", "receive_ns") if name in header]
        # The columns asked for stand before any text, so that splitting at commas is right.
        tick = header.index("tick") if "tick" in header[:3] else None
        places = wanted if tick is None else [*wanted, tick]
        rows, columns = _integers(file, places)
    entry: dict[str, Any] = {"columns": header, "rows": rows, HASH: file_hash(path)}
    entry.update(first_stamp_ns=None, last_stamp_ns=None, rate_hz=None, gap_max_s=None, gaps=0)
    if len(wanted) < 2 or not rows:
        return entry
    if columns is None:
        return {**entry, "problem": "a line's stamp is no integer"}
    stamps, received = columns[:2]
    ticks = None if tick is None else columns[2]
    if not stamps.any():
        stamps = received
    entry["first_stamp_ns"], entry["last_stamp_ns"] = int(stamps[0]), int(stamps[-1])
    if len(stamps) > 1:
        distance = np.diff(stamps) * 1e-9
        span = (int(stamps[-1]) - int(stamps[0])) * 1e-9
        entry["rate_hz"] = float((len(stamps) - 1) / span) if span > 0 else None
        entry["gap_max_s"] = float(distance.max())
        entry["gaps"] = int(np.sum(distance > 1.5 * np.median(distance)))
    if ticks is not None:
        entry["missing_ticks"] = int(ticks.max() - ticks.min() + 1 - len(np.unique(ticks)))
    return entry


def _integers(
    lines: Iterable[str], places: Sequence[int]
) -> tuple[int, list[npt.NDArray[np.int64]] | None]:
    """Number of lines, and some of their fields; no fields if one is no 64-bit integer.

    Lines are not kept: those of 30 minutes are 500 MB.
    """
    rows, values, parts = 0, [array.array("q") for _ in places], max(places, default=0) + 1
    sound = True
    for line in lines:
        rows += 1
        if sound:
            fields = line.split(",", parts)
            try:
                for column, place in zip(values, places, strict=True):
                    column.append(int(fields[place]))
            except (ValueError, IndexError, OverflowError):
                sound = False
    return rows, [np.frombuffer(v, np.int64) for v in values] if sound and rows else None


def _header(line: str) -> list[str]:
    try:
        return next(csv.reader([line]), [])
    except csv.Error:
        return []


def utc_now() -> str:
    """The present in UTC, ISO 8601 with seconds."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def clean_json(value: Any) -> Any:
    """The value with Python's numbers instead of numpy's, and None for non-finite ones."""
    if isinstance(value, Mapping):
        return {str(key): clean_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [clean_json(item) for item in value]
    if isinstance(value, np.ndarray):
        return clean_json(value.tolist())
    if isinstance(value, np.generic):
        return clean_json(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, through a temporary file."""
    temporary = path.with_name(path.name + ".tmp")
    with open(temporary, "w", encoding="utf-8") as file:
        json.dump(clean_json(value), file, indent=1, allow_nan=False, default=str)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
