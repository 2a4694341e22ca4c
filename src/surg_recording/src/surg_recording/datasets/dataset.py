"""The values of an export: converted recordings (parts), and the data set that they make."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.datasets.layout import Layout
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature, from_description
from surg_recording.recording_errors import EpisodeError

PART = "part.json"


@dataclasses.dataclass(frozen=True)
class Part:
    """One converted recording, or a piece of a long one, to be assembled with others."""

    folder: Path
    key: str
    """Input hash: of the recording's files, the options and the exporter."""
    source: str
    kind: str
    instruction: str
    stages: tuple[str, ...]
    """Instructions of the stages, each once, in order of appearance."""
    frames: int
    fps: int
    features: tuple[Feature, ...]
    about: Mapping[str, Any]
    notes: Mapping[str, Any]
    piece: str = ""
    """Which piece of a long recording this is, such as ``2 of 3``; empty: all of it."""

    def save(self) -> None:
        """Write ``part.json``."""
        stated = dataclasses.asdict(self)
        stated["folder"] = None
        stated["features"] = [feature.describe() for feature in self.features]
        (self.folder / PART).write_text(json.dumps(stated, indent=1, default=str) + "\n", "utf-8")

    @staticmethod
    def load_all(folder: Path) -> list[Part]:
        """The parts of one recording in order; an EpisodeError if one is missing or broken."""
        pieces = sorted(folder.iterdir(), key=lambda piece: int(piece.name))
        return [Part.load(piece) for piece in pieces]

    @staticmethod
    def load(folder: Path) -> Part:
        """Read ``part.json``; an EpisodeError if it is missing or broken."""
        try:
            stated = json.loads((folder / PART).read_text("utf-8"))
            stated["folder"] = folder
            stated["stages"] = tuple(stated["stages"])
            stated["features"] = tuple(map(from_description, stated["features"]))
            return Part(**stated)
        except (OSError, ValueError, KeyError, TypeError) as problem:
            raise EpisodeError(f"{folder}: no converted recording ({problem}); delete it") from None


@dataclasses.dataclass(frozen=True)
class Dataset:
    """Everything an exporter needs to assemble parts."""

    name: str
    parts: tuple[Part, ...]
    splits: Mapping[str, tuple[int, int]]
    """Split → first recording, and the one after the last."""
    layout: Layout
    options: ExportOptions

    @property
    def features(self) -> tuple[Feature, ...]:
        """Of every recording."""
        return self.parts[0].features

    @property
    def robot_type(self) -> str:
        """Names of the robots, such as ``ur5e`` or ``ur5e+panda``."""
        return "+".join(dict.fromkeys(self.layout.robots))

    @property
    def tasks(self) -> list[str]:
        """Instructions in words, each once, in order of appearance."""
        return list(dict.fromkeys(part.instruction for part in self.parts))

    @property
    def stages(self) -> list[str]:
        """Instructions of the stages, each once, in order of appearance."""
        return list(dict.fromkeys(stage for part in self.parts for stage in part.stages))

    @property
    def frames(self) -> int:
        """Of all recordings."""
        return sum(part.frames for part in self.parts)
