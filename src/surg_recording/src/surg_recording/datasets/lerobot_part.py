"""One recording as both LeRobot formats store it: a table, and a video per camera."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pyarrow.parquet as pq

from surg_recording.datasets import pictures, schema
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.lerobot_tables import COLOURS, DATA, table_of
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.sampling import Sampled
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
            seen = pictures.Seen()
            target = folder / f"{feature.name}.mp4"
            frames = pictures.watch(sampled.frames(feature.name), seen, grid.frames, options.size)
            pictures.encode(frames, target, options)
            pictures.check_video(target, options, seen.prints)
            if len(seen.prints) != grid.frames:
                raise EpisodeError(
                    f"{target}: {len(seen.prints)} frames, the grid has {grid.frames}"
                )
            counted[feature.name] = {"sampled": seen.sampled, "histogram": seen.histogram.tolist()}
        (folder / COLOURS).write_text(json.dumps(counted) + "\n", "utf-8")
