"""The recorder's parameters: read once, checked, and never looked at again."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_recording.episode.episode_writer import MIN_FREE_BYTES
from surg_ros.camera_topic import camera_topic

MODES = ("lockstep", "freerun")
PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow")


@dataclasses.dataclass(frozen=True)
class Settings:
    """What the recorder is told at its start."""

    out: Path
    cell: Path | None
    mode: str
    arms: tuple[str, ...]
    cameras: dict[str, str]
    """Name → topic."""
    topics: tuple[str, ...]
    """Names and patterns of further topics."""
    run_info: dict[str, Any]
    autostart: bool
    min_free_bytes: int
    video_preset: str

    @classmethod
    def read(cls, get: Callable[[str, Any], Any]) -> Settings:
        """Read and check.

        Args:
            get: gives a parameter (``~name``) or, where it is not set, the default.

        Raises:
            ValueError: parameter, value and what is allowed.
        """
        out = str(get("~out", ""))
        if not out:
            raise ValueError("parameter ~out is missing: the folder the episode is written to")
        arms = names(get("~arms", ["PSM1"]), "~arms")
        if not arms:
            raise ValueError("parameter ~arms is empty: at least one arm, e.g. [PSM1]")
        cameras = [camera_topic(name) for name in names(get("~cameras", []), "~cameras")]
        if len(dict(cameras)) != len(cameras):
            said = ", ".join(f"{name} ({topic})" for name, topic in cameras)
            raise ValueError(f"parameter ~cameras names a camera twice: {said}")
        cell = get("~cell", "")
        return cls(
            out=Path(out).resolve(),
            cell=Path(str(cell)).resolve() if cell else None,
            mode=_one_of(get("~mode", "lockstep"), "~mode", MODES),
            arms=tuple(name.strip("/") for name in arms),
            cameras=dict(cameras),
            topics=tuple(names(get("~topics", []), "~topics")),
            run_info=_object(get("~run_info", {}), "~run_info"),
            autostart=bool(get("~autostart", True)),
            min_free_bytes=_bytes(get("~min_free_bytes", MIN_FREE_BYTES), "~min_free_bytes"),
            video_preset=_one_of(get("~video_preset", "ultrafast"), "~video_preset", PRESETS),
        )


def names(value: Any, parameter: str) -> list[str]:
    """A list parameter; also taken from a command line as ``a,b`` or ``[a, b]``.

    Raises:
        ValueError: it is none.
    """
    if isinstance(value, str):
        whole = value.startswith("[") and value.endswith("]")
        value = (value[1:-1] if whole else value).split(",")
    if not isinstance(value, list):
        raise ValueError(f"parameter {parameter} is {value!r}, must be a list of names")
    return [name for name in (str(item).strip(" '\"") for item in value) if name]


def _one_of(value: Any, parameter: str, allowed: tuple[str, ...]) -> str:
    if value not in allowed:
        raise ValueError(f"parameter {parameter} is {value!r}, allowed are {', '.join(allowed)}")
    return str(value)


def _object(value: Any, parameter: str) -> dict[str, Any]:
    try:
        value = json.loads(value) if isinstance(value, str) and value else value or {}
    except ValueError as problem:
        raise ValueError(f"parameter {parameter} is no valid JSON ({problem})") from problem
    if not isinstance(value, dict):
        raise ValueError(f"parameter {parameter} must be a JSON object")
    return value


def _bytes(value: Any, parameter: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < 1e19:
        raise ValueError(f"parameter {parameter} is {value!r}, must be a number >= 0")
    return int(value)
