"""A dataset format: how it writes one recording, joins many, and checks the result."""

from __future__ import annotations

import abc
import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import ExportError, Progress, Report
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions


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
        from surg_recording.datasets import pipeline  # which imports this module

        return pipeline.export(self, episodes, out, options, progress)

    def require(self) -> None:
        """Check that the format's packages are installed; an ExportError names those missing."""
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        if missing:
            cures = "; ".join(f"{name}: {self.needs[name]}" for name in missing)
            raise ExportError(f"format {self.name} needs {', '.join(missing)} ({cures})")
