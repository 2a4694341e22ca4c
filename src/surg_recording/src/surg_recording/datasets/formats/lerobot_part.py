"""One recording as both LeRobot formats store it: a table, and a video per camera."""

from __future__ import annotations

import abc
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import av
import pyarrow.parquet as pq

from surg_recording.datasets import pictures, schema, stream_copy
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.formats.lerobot_tables import COLOURS, DATA, table_of
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import COPY, ExportOptions
from surg_recording.recording_errors import EpisodeError

LONGEST_S = 1000.0
"""Longest video and episode [s]: lerobot keeps time in float32 seconds with a tolerance of 0.1 ms.

Neighbouring float32 values lie 0.06 ms apart below 1024 s, and 0.12 ms above.
"""


class LeRobotExporter(Exporter):
    """Writes the parts of both LeRobot formats."""

    needs: ClassVar[Mapping[str, str]] = {"pyarrow": "pip install 'surg_recording[lerobot]'"}
    longest_s: ClassVar[float | None] = LONGEST_S

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """A table and a video per camera, read back."""
        grid = sampled.grid
        table = table_of(sampled.columns, sampled.features)
        pq.write_table(table, folder / DATA)
        if not pq.read_table(folder / DATA).equals(table):
            raise EpisodeError(f"{folder / DATA}: what was read back is not what was written")
        counted: dict[str, Any] = {}
        for feature in schema.videos_of(sampled.features):
            statistics = pictures.PictureStatistics()
            target = folder / f"{feature.name}.mp4"
            frames = pictures.watch(
                sampled.frames(feature.name), statistics, grid.frames, options.size
            )
            self._write_video(sampled, feature.name, frames, target, options)
            pictures.check_video(target, options, statistics.prints)
            if len(statistics.prints) != grid.frames:
                raise EpisodeError(
                    f"{target}: {len(statistics.prints)} frames, the grid has {grid.frames}"
                )
            counted[feature.name] = {
                "sampled": statistics.sampled,
                "histogram": statistics.histogram.tolist(),
            }
        (folder / COLOURS).write_text(json.dumps(counted) + "\n", "utf-8")

    def validate(self, out: Path) -> Report:
        """Read everything: rows, videos, statistics, splits, the page of the data set."""
        report = Report(self.name, out)
        with report.reading():
            self._validate(out, report)
        return report

    @abc.abstractmethod
    def _validate(self, out: Path, report: Report) -> None:
        """Add the frames and errors of a finished export to a report."""

    def _write_video(
        self,
        sampled: Sampled,
        feature: str,
        frames: Iterator[av.VideoFrame],
        target: Path,
        options: ExportOptions,
    ) -> None:
        """Copy the recorded stream where that is asked for and possible; else encode anew."""
        if options.video == COPY:
            shown = sampled.pictures[feature]
            path, indices = shown.video.path, [int(i) for i in shown.index]
            obstacle = stream_copy.obstacle(path, indices, options)
            if obstacle is None:
                stream_copy.copy(path, indices, target, options)
                for _ in frames:  # looked at all the same: thumbnails and colours
                    pass
                return
            remark = f"{path.name} is encoded anew: {obstacle}"
            remarks = sampled.notes.setdefault("remarks", [])
            if remark not in remarks:  # a long recording has several pieces
                remarks.append(remark)
        pictures.encode(frames, target, options)
