"""Datasets from recordings: a resampler, a feature schema, and exporters for training formats.

Plain Python; no ROS, no torch, no lerobot. ``load("lerobot").write(folders, out, ExportOptions())``
exports. docs/reference/datasets.md describes the result, docs/guide/adding_an_exporter.md how to
add a format.
"""

from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.export_manifest import check
from surg_recording.datasets.export_report import ExportError, Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.exporter_plugins import load, names
from surg_recording.datasets.frames.sampling import Sampled, sample
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.pipeline import dry_run
from surg_recording.datasets.schema import Feature

__all__ = [
    "Dataset",
    "ExportError",
    "ExportOptions",
    "Exporter",
    "Feature",
    "Part",
    "Report",
    "Sampled",
    "check",
    "dry_run",
    "load",
    "names",
    "sample",
]
