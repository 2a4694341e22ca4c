"""The class that a bundled exporter extends: a format that writes data sets by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from surg_recording.datasets import pipeline
from surg_recording.datasets.dataset_format import DatasetFormat
from surg_recording.datasets.export_report import Progress, Report
from surg_recording.datasets.options import ExportOptions


class Exporter(DatasetFormat):
    """A dataset format. Recordings are converted one by one, anywhere, then assembled."""

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
        return pipeline.export(self, episodes, out, options, progress)
