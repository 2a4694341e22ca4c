"""Checks the types in a manifest, so that a reader meets only what the format allows.

A manifest may come from another program, or from an editor. A wrong type is named here by its key
instead of failing in the middle of an evaluation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from surg_recording.recording_errors import EpisodeError

Check = Callable[[Any], bool]


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63


def _is_count(value: Any) -> bool:
    return _is_integer(value) and value >= 0


def _is_scalar(value: Any) -> bool:
    return isinstance(value, str | int | float)


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _is_objects(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_object, value))


def _is_texts_by_name(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_tags(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(tag, str | dict) for tag in value)


def _is_truth(value: Any) -> bool:
    return isinstance(value, bool)


_WORDS: dict[Check, str] = {
    _is_text: "a text",
    _is_integer: "a 64-bit integer",
    _is_count: "a count",
    _is_scalar: "a text or a number",
    _is_object: "an object",
    _is_objects: "a list of objects",
    _is_texts: "a list of texts",
    _is_texts_by_name: "an object of texts",
    _is_tags: "a list of texts or objects",
    _is_truth: "true, false or null",
}
_TOP: dict[str, Check] = {
    **dict.fromkeys(("created", "outcome", "reason", "mode", "clock"), _is_text),
    **dict.fromkeys(("arms", "cameras", "warnings"), _is_texts),
    **dict.fromkeys(("run", "sim", "result", "cell", "versions", "topics"), _is_object),
    "camera_info": _is_object,
    **dict.fromkeys(("stages", "segments", "amendments"), _is_objects),
    **dict.fromkeys(("task", "setting", "operator", "seed"), _is_scalar),
    "tags": _is_tags,
}
_WITHIN: dict[str, dict[str, Check]] = {
    "run": {
        **dict.fromkeys(("robot", "motion", "mode", "law", "link", "setting"), _is_scalar),
        **dict.fromkeys(("task", "title", "operator", "seed", "scale", "instruction"), _is_scalar),
        "stages": _is_texts_by_name,
    },
    "sim": {"task": _is_object, "state_hash": _is_text},
    "result": {"success": _is_truth, "reason": _is_text, "by": _is_text},
    "cell": {
        **dict.fromkeys(("arms", "endoscope"), _is_object),
        **dict.fromkeys(("calibration", "files"), _is_texts_by_name),
        "name": _is_scalar,
    },
}
_ITEMS: dict[str, dict[str, Check]] = {
    "stages": {
        **dict.fromkeys(("name", "text", "by"), _is_text),
        **dict.fromkeys(("begin_ns", "end_ns"), _is_integer),
    },
    "segments": {
        **dict.fromkeys(("begin_ns", "step_ns"), _is_integer),
        **dict.fromkeys(("rows", "frames"), _is_object),
    },
    "amendments": {"files": _is_object},
}
"""Keys of the objects in a list."""
_FILE: dict[str, Check] = {
    **dict.fromkeys(("rows", "frames", "dropped"), _is_count),
    **dict.fromkeys(("first_stamp_ns", "last_stamp_ns", "missing_ticks"), _is_integer),
    **dict.fromkeys(("sha256", "video_sha256", "part_of"), _is_text),
    "columns": _is_texts,
    "kinds": _is_object,
}
"""Keys of the entries of ``tables`` and ``videos``."""

_PART = re.compile(r"(.+)\.\d+")


def check(place: object, manifest: Mapping[str, Any]) -> None:
    """Raise an EpisodeError that names the first key of a wrong type; ``place`` is the file."""
    for key in ("tables", "videos"):
        if not isinstance(manifest.get(key), dict):
            raise EpisodeError(f"{place}: key {key!r} is missing or no object")
        for name, entry in manifest[key].items():
            where = f"{key}.{name}"
            _check_name(place, where, name, folders=key == "tables")
            if not _is_object(entry):
                _refuse(place, where, entry, _is_object)
            _check_keys(place, where, entry, _FILE)
            part_of = entry.get("part_of")
            if part_of and ((match := _PART.fullmatch(name)) is None or match[1] != part_of):
                raise EpisodeError(f"{place}: key {where!r} is no name of a part of {part_of!r}")
    _check_keys(place, "", manifest, _TOP)
    for key, checks in _WITHIN.items():
        _check_keys(place, key, manifest.get(key) or {}, checks)
    for key, checks in _ITEMS.items():
        for number, item in enumerate(manifest.get(key) or []):
            _check_keys(place, f"{key}[{number}]", item, checks)
    for arm, entry in ((manifest.get("cell") or {}).get("arms") or {}).items():
        parts = dict.fromkeys(("robot", "instrument"), _is_object)
        if not _is_object(entry):
            _refuse(place, f"cell.arms.{arm}", entry, _is_object)
        _check_keys(place, f"cell.arms.{arm}", entry, parts)


def _check_name(place: object, where: str, name: str, folders: bool) -> None:
    """A name must stay inside the folder of the episode."""
    steps = name.split("/")
    if "\0" in name or any(step in ("", ".", "..") for step in steps) or len(steps) > 1 + folders:
        raise EpisodeError(f"{place}: key {where!r} is no name of a file of the episode")


def _check_keys(
    place: object, within: str, entry: Mapping[str, Any], checks: Mapping[str, Check]
) -> None:
    """Check the keys that are there; null means "not stated"."""
    for key, fits in checks.items():
        value = entry.get(key)
        if value is not None and not fits(value):
            _refuse(place, f"{within}.{key}" if within else key, value, fits)


def _refuse(place: object, key: str, value: Any, fits: Check) -> None:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:60] + "…"
    raise EpisodeError(f"{place}: key {key!r} is {shown}, {_WORDS[fits]} is needed")
