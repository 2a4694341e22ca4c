"""The interface of an exporter, and how one is found: by name, entry point, or file.

An entry point in the group ``surg_recording.exporters`` names a class:
``my_format = my_package.my_format:MyExporter``; see docs/guide/adding_an_exporter.md.
"""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import importlib.util
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from surg_core.plugins import PluginError, PluginKind
from surg_recording.datasets.inspection import Layout
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.sampling import Sampled
from surg_recording.datasets.schema import Feature, from_description
from surg_recording.recording_errors import EpisodeError

GROUP = "surg_recording.exporters"
"""Entry points of other packages."""

MANIFEST = "surg_export.json"
"""File with the inputs of an export and the checksum of every file."""

_BUNDLED = {
    "lerobot": "lerobot_v21",
    "lerobot_v21": "lerobot_v21",
    "lerobot_v30": "lerobot_v30",
    "robomimic": "robomimic",
    "act": "act",
    "diffusion_policy": "diffusion_policy",
}
"""Name on the command line → module of this package; ``lerobot`` is the default version."""
_WITH_ROS = {
    "mcap": "surg_recording.nodes.mcap_exporter_node",
    "rosbag": "surg_recording.nodes.rosbag_exporter_node",
}
_KIND = PluginKind(
    noun="exporter",
    group=GROUP,
    bundled={
        **{name: f"surg_recording.datasets.{module}" for name, module in _BUNDLED.items()},
        **_WITH_ROS,
    },
    accepts=lambda kind: all(hasattr(kind, part) for part in ("name", "write", "validate")),
    shape="one class with name, write and validate (see surg_recording.datasets.Exporter)",
)

Progress = Callable[[float | None, str], None]
"""Called with the done part in [0, 1] and a few words."""


class ExportError(Exception):
    """An export that cannot be done at all; the message says what to do."""


@dataclasses.dataclass
class Report:
    """Result of an export or of a check of one."""

    format: str
    out: Path
    recordings: int = 0
    frames: int = 0
    made: int = 0
    """Recordings converted in this run; the others were there already."""
    refused: dict[str, str] = dataclasses.field(default_factory=dict)
    """Recording → why it is not in the export."""
    errors: list[str] = dataclasses.field(default_factory=list)
    """What is wrong with the export; empty if it is good."""
    warnings: list[str] = dataclasses.field(default_factory=list)
    facts: dict[str, Any] = dataclasses.field(default_factory=dict)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Damaged files fail in many ways: every exception becomes an error of the report."""
        try:
            yield
        except Exception as problem:
            self.errors.append(f"{type(problem).__name__}: {problem}")

    @property
    def ok(self) -> bool:
        """The export is good, and contains every recording."""
        return not self.errors and not self.refused

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return {**dataclasses.asdict(self), "out": str(self.out), "ok": self.ok}


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


PART = "part.json"


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


class Exporter(abc.ABC):
    """A dataset format. Recordings are converted one by one, anywhere, then assembled."""

    name: ClassVar[str]
    """Name on the command line."""
    title: ClassVar[str]
    """Name in texts."""
    version: ClassVar[int] = 3
    """Increase it when the same input gives another output."""
    needs: ClassVar[Mapping[str, str]] = {}
    """Module → how to get it."""
    longest_s: ClassVar[float | None] = None
    """A longer recording becomes several episodes of at most this length [s]; None: no limit."""

    def write(
        self,
        episodes: Sequence[Path],
        out: Path,
        options: ExportOptions,
        progress: Progress = lambda fraction, note: None,
    ) -> Report:
        """Export recordings to the folder ``out``; an ExportError if nothing can be exported.

        ``episodes`` are folders of recordings, or folders that hold some; ``progress`` gets the
        state of the work.
        """
        from surg_recording.datasets import pipeline

        return pipeline.export(self, episodes, out, options, progress)

    @abc.abstractmethod
    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """Write one recording into an empty folder, and compare what is read back.

        Raises:
            EpisodeError: The recording is broken, or the comparison fails.
        """

    @abc.abstractmethod
    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Assemble parts in an empty folder; an EpisodeError if they do not fit together."""

    @abc.abstractmethod
    def validate(self, out: Path) -> Report:
        """Check a finished export by reading everything in it."""

    def require(self) -> None:
        """Check that the format's packages are installed; an ExportError names those missing."""
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        if missing:
            cures = "; ".join(f"{name}: {self.needs[name]}" for name in missing)
            raise ExportError(f"format {self.name} needs {', '.join(missing)} ({cures})")


def names() -> tuple[str, ...]:
    """Names that ``load`` knows: the bundled formats, then those of installed packages."""
    return _KIND.names()


def load(name_or_path: str) -> Any:
    """A new exporter by name or ``.py`` file; an ExportError lists those that exist.

    A file is executed: load none that you would not run. The exporter has ``name``, ``write`` and
    ``validate``; the bundled ones are ``Exporter``.
    """
    try:
        return _KIND.find(name_or_path)()
    except PluginError as error:
        raise ExportError(str(error)) from error
