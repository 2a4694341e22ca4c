"""Labels given after the recording: verdict, stages, trim and note.

They stand in a side file, ``labels.json``, and never change what was recorded. The reader of an
episode applies them: the verdict counts first, the stages replace the recorded ones, and exports
and evaluations use the time between the ends of the trim.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError

LABELS = "labels.json"
FORMAT = "surg_labels/1"

MAX_STAGES = 500
MAX_NAME, MAX_NOTE = 200, 4000
"""Characters of a stage's or a person's name, and of a note."""

KEY = "labels"
"""Key of the labels in the manifest of an episode that has been read."""


def parse(stated: Any) -> dict[str, Any]:
    """Complete labels from stated ones; a ValueError names the key, its value and what is allowed.

    ``success`` is true, false or null (not judged), ``stages`` a list of ``name``, ``begin_ns`` and
    ``end_ns`` or null (as recorded), ``trim`` has ``begin_ns`` and ``end_ns``, null where nothing
    is cut off; times are stamps of the episode [ns].
    """
    if not isinstance(stated, Mapping):
        raise ValueError(f"labels: {stated!r:.60} is not an object")
    unknown = sorted(set(stated) - {"format", *_TEXTS, "success", "stages", "trim"})
    if unknown:
        raise ValueError(f"labels: key {unknown[0]!r} is unknown")
    success = stated.get("success")
    if not (success is None or isinstance(success, bool)):
        raise ValueError(f"success: {success!r:.60}; allowed are true, false and null")
    return {
        "format": FORMAT,
        **{key: _text(stated.get(key), key, most) for key, most in _TEXTS.items()},
        "success": success,
        "stages": _stages(stated.get("stages")),
        "trim": _trim(stated.get("trim")),
    }


_TEXTS = {"by": MAX_NAME, "at": MAX_NAME, "note": MAX_NOTE}


def read(folder: Path) -> dict[str, Any] | None:
    """The labels of an episode; None without any, an EpisodeError if the file cannot be used."""
    path = folder / LABELS
    if not os.path.lexists(path):
        return None
    stated = read_json(path)
    if not isinstance(stated, dict) or stated.get("format") != FORMAT:
        raise EpisodeError(f"{path}: format is not {FORMAT}; delete the file, or label again")
    try:
        return parse(stated)
    except ValueError as problem:
        raise EpisodeError(f"{path}: {problem}") from None


def apply(manifest: Mapping[str, Any], labels: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest with the labels under ``labels``, and with their stages."""
    labelled: dict[str, Any] = {**manifest, KEY: dict(labels)}
    if labels["stages"] is not None:
        texts = (manifest.get("run") or {}).get("stages") or {}
        labelled["stages"] = [
            {
                **stage,
                "by": labels["by"],
                **({"text": texts[stage["name"]]} if stage["name"] in texts else {}),
            }
            for stage in labels["stages"]
        ]
    return labelled


def trim(manifest: Mapping[str, Any]) -> tuple[int, int]:
    """First and last stamp to use [ns]; without a trim all of int64."""
    ends = (manifest.get(KEY) or {}).get("trim") or {}
    begin, end = ends.get("begin_ns"), ends.get("end_ns")
    return (-(2**63) if begin is None else begin, 2**63 - 1 if end is None else end)


def _stages(stated: Any) -> list[dict[str, Any]] | None:
    if stated is None:
        return None
    if not isinstance(stated, list) or len(stated) > MAX_STAGES:
        raise ValueError(f"stages: a list of at most {MAX_STAGES} is needed")
    found: list[dict[str, Any]] = []
    for number, stage in enumerate(stated):
        where = f"stages[{number}]"
        if not isinstance(stage, Mapping) or set(stage) != {"name", "begin_ns", "end_ns"}:
            raise ValueError(f"{where}: an object of name, begin_ns and end_ns is needed")
        name = _text(stage["name"], f"{where}.name", MAX_NAME)
        begin = _stamp(stage["begin_ns"], f"{where}.begin_ns")
        end = None if stage["end_ns"] is None else _stamp(stage["end_ns"], f"{where}.end_ns")
        last = found[-1] if found else None
        after = 0
        if last is not None:
            after = last["begin_ns"] if last["end_ns"] is None else last["end_ns"]
        if not name or begin < after or (end is not None and end < begin):
            raise ValueError(f"{where}: needs a name, and times that follow each other")
        if last is not None and last["end_ns"] is None:
            last["end_ns"] = begin
        found.append({"name": name, "begin_ns": begin, "end_ns": end})
    return found


def _trim(stated: Any) -> dict[str, int | None] | None:
    if stated is None:
        return None
    if not isinstance(stated, Mapping) or set(stated) != {"begin_ns", "end_ns"}:
        raise ValueError("trim: an object of begin_ns and end_ns is needed")
    ends = {k: None if v is None else _stamp(v, f"trim.{k}") for k, v in stated.items()}
    begin, end = ends["begin_ns"], ends["end_ns"]
    if begin is not None and end is not None and begin >= end:
        raise ValueError("trim: begin_ns must be before end_ns")
    return None if begin is None and end is None else ends


def _stamp(value: Any, key: str) -> int:
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{key}: {value!r:.60}; an integer of nanoseconds >= 0 is needed")
    return value


def _text(value: Any, key: str, most: int) -> str:
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > most:
        raise ValueError(f"{key}: a text of at most {most} characters is needed")
    return value
