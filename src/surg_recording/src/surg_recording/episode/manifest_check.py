"""Checks the types in a manifest, so that a reader meets only what the format allows.

A manifest may come from another program, or from an editor. A wrong type is named here by its key
instead of failing in the middle of an evaluation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from surg_recording.recording_errors import EpisodeError


class Kind(NamedTuple):
    """What a key may hold."""

    words: str
    """For the message."""
    fits: Callable[[Any], bool]


def _are(*kinds: type) -> Callable[[Any], bool]:
    """Whether a value is a list of these."""
    return lambda value: isinstance(value, list) and all(isinstance(x, kinds) for x in value)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63


def _is_texts_by_name(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(text, str) for text in value.values())


_TEXT = Kind("a text", lambda value: isinstance(value, str))
_INTEGER = Kind("a 64-bit integer", _is_integer)
_COUNT = Kind("a count", lambda value: _is_integer(value) and value >= 0)
_SCALAR = Kind("a text or a number", lambda value: isinstance(value, str | int | float))
_OBJECT = Kind("an object", lambda value: isinstance(value, dict))
_OBJECTS = Kind("a list of objects", _are(dict))
_TEXTS = Kind("a list of texts", _are(str))
_TEXTS_BY_NAME = Kind("an object of texts", _is_texts_by_name)
_TAGS = Kind("a list of texts or objects", _are(str, dict))
_TRUTH = Kind("true, false or null", lambda value: isinstance(value, bool))

_TOP: dict[str, Kind] = {
    **dict.fromkeys(("created", "outcome", "reason", "mode", "clock"), _TEXT),
    **dict.fromkeys(("arms", "cameras", "warnings"), _TEXTS),
    **dict.fromkeys(("run", "sim", "result", "cell", "versions", "topics"), _OBJECT),
    "camera_info": _OBJECT,
    **dict.fromkeys(("stages", "segments"), _OBJECTS),
    **dict.fromkeys(("task", "setting", "operator", "seed"), _SCALAR),
    "tags": _TAGS,
}
_WITHIN: dict[str, dict[str, Kind]] = {
    "run": {
        **dict.fromkeys(("robot", "motion", "mode", "law", "link", "setting"), _SCALAR),
        **dict.fromkeys(("task", "title", "operator", "seed", "scale", "instruction"), _SCALAR),
        "stages": _TEXTS_BY_NAME,
    },
    "sim": {"task": _OBJECT, "state_hash": _TEXT},
    "result": {"success": _TRUTH, "reason": _TEXT, "by": _TEXT},
    "cell": {
        **dict.fromkeys(("arms", "endoscope"), _OBJECT),
        **dict.fromkeys(("calibration", "files"), _TEXTS_BY_NAME),
        "name": _SCALAR,
    },
}
_ITEMS: dict[str, dict[str, Kind]] = {
    "stages": {
        **dict.fromkeys(("name", "text", "by"), _TEXT),
        **dict.fromkeys(("begin_ns", "end_ns"), _INTEGER),
    },
    "segments": {
        **dict.fromkeys(("begin_ns", "step_ns"), _INTEGER),
        **dict.fromkeys(("rows", "frames"), _OBJECT),
    },
}
"""Keys of the objects in a list."""
_FILE: dict[str, Kind] = {
    **dict.fromkeys(("rows", "frames", "dropped"), _COUNT),
    **dict.fromkeys(("first_stamp_ns", "last_stamp_ns", "missing_ticks"), _INTEGER),
    **dict.fromkeys(("sha256", "video_sha256", "part_of"), _TEXT),
    "columns": _TEXTS,
    "kinds": _OBJECT,
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
            if not _OBJECT.fits(entry):
                _refuse(place, where, entry, _OBJECT)
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
        parts = dict.fromkeys(("robot", "instrument"), _OBJECT)
        if not _OBJECT.fits(entry):
            _refuse(place, f"cell.arms.{arm}", entry, _OBJECT)
        _check_keys(place, f"cell.arms.{arm}", entry, parts)


def _check_name(place: object, where: str, name: str, folders: bool) -> None:
    """A name must stay inside the folder of the episode."""
    steps = name.split("/")
    if "\0" in name or any(step in ("", ".", "..") for step in steps) or len(steps) > 1 + folders:
        raise EpisodeError(f"{place}: key {where!r} is no name of a file of the episode")


def _check_keys(
    place: object, within: str, entry: Mapping[str, Any], checks: Mapping[str, Kind]
) -> None:
    """Check the keys that are there; null means "not stated"."""
    for key, kind in checks.items():
        value = entry.get(key)
        if value is not None and not kind.fits(value):
            _refuse(place, f"{within}.{key}" if within else key, value, kind)


def _refuse(place: object, key: str, value: Any, kind: Kind) -> None:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:60] + "…"
    raise EpisodeError(f"{place}: key {key!r} is {shown}, {kind.words} is needed")
