"""The columns of a dataset under construction: features with their values, on one grid."""

from __future__ import annotations

import fnmatch
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import ACTION_KEY
from surg_recording.datasets.frames.resample import Grid, Stamps
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import ALWAYS, OPTIONAL, Feature
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]

LINEAR = "linear interpolation"
HOLD = "zero-order hold"
BEFORE = "newest sample before the frame"
NEXT = "zero-order hold at the next grid time"


class Columns:
    """The features of one recording, and their values."""

    def __init__(self, grid: Grid, options: ExportOptions, gap_ns: int) -> None:
        """``gap_ns``: samples of motion that are further apart are not bridged."""
        self.grid, self.options, self.gap_ns = grid, options, gap_ns
        self.features: list[Feature] = []
        self.columns: dict[str, npt.NDArray[Any]] = {}
        self.dropped: list[str] = []
        self.notes: dict[str, Any] = {}

    def add(self, feature: Feature, values: npt.NDArray[Any] | None) -> None:
        """Add a feature unless ``options.drop`` names it, or ``options.columns`` does not."""
        if feature.name in self.options.drop or not self._kept(feature.name):
            self.dropped.append(feature.name)
            return
        self.features.append(feature)
        if values is None:  # a video
            return
        if feature.dtype != "string":
            with np.errstate(over="ignore"):
                values = values.astype(feature.dtype)
        if feature.dtype in ("float32", "float64") and not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise EpisodeError(
                f"{feature.name}: not a number, or too large for {feature.dtype}, at frame {row};"
                f" --drop {feature.name} leaves it out"
            )
        self.columns[feature.name] = values

    def _kept(self, name: str) -> bool:
        columns = self.options.columns
        if columns is None or name in (ACTION_KEY, *ALWAYS):
            return True
        return any(fnmatch.fnmatchcase(name, column) for column in columns)

    def finish(self) -> tuple[Feature, ...]:
        """Add the grid's times; returns all features in the order of a data set.

        Raises:
            EpisodeError: ``drop`` or ``columns`` asks for what the recording does not have.
        """
        text = "time of the frame on the recording's clock"
        self.number("timing.grid_ns", self.grid.times_ns, "int64", ("ns",), text=text)
        features = tuple(sorted(self.features, key=lambda feature: feature.rank))
        unknown = set(self.options.drop) - set(self.dropped) - OPTIONAL
        if unknown:
            raise EpisodeError(
                f"--drop {', '.join(sorted(unknown))}: no such feature; there are"
                f" {', '.join(feature.name for feature in features)}"
            )
        names = [*(feature.name for feature in self.features), *self.dropped]
        for column in self.options.columns or ():
            if not any(fnmatch.fnmatchcase(name, column) for name in names):
                raise EpisodeError(
                    f"--columns {column}: no such feature; there are {sorted(names)}"
                )
        return features

    def vector(
        self,
        name: str,
        values: Array,
        names: tuple[str, ...],
        units: tuple[str, ...],
        frame: str,
        method: str,
        text: str,
        privileged: bool = False,
    ) -> None:
        """Add a vector of float32."""
        values = values[:, 0] if len(names) == 1 else values
        shape = (len(names),)
        self.add(
            Feature(name, "float32", shape, names, units, frame, method, text, privileged), values
        )

    def number(
        self,
        name: str,
        values: npt.NDArray[Any],
        dtype: str,
        units: tuple[str, ...],
        method: str = "",
        text: str = "",
        privileged: bool = False,
    ) -> None:
        """Add a single number per frame."""
        last = name.rpartition(".")[2]
        self.add(Feature(name, dtype, (1,), (last,), units, "", method, text, privileged), values)

    def text(
        self, name: str, value: str | npt.NDArray[Any], text: str, method: str = "constant"
    ) -> None:
        """Add a text for every frame: the same, or one of (frames,) objects each."""
        words = np.full(self.grid.frames, value, dtype=object)
        self.add(Feature(name, "string", (1,), ("text",), text=text, method=method), words)

    def timing(self, name: str, stamps: Stamps, index: Stamps, times: Stamps, text: str) -> None:
        """Add true stamps and ages of the samples behind a series."""
        self.number(f"timing.{name}.stamp_ns", stamps[index], "int64", ("ns",), text=text)
        ages = (times - stamps[index]) * 1e-9
        self.number(f"timing.{name}.age_s", ages, "float32", ("s",), text="its age at that time")
        self.notes[f"oldest_{name}_s"] = float(ages.max())
