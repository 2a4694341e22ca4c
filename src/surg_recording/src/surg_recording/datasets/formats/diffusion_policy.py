"""Zarr (format 2) as diffusion_policy reads it: ``replay.zarr`` with all recordings end to end.

Facts about that reader (``ReplayBuffer``): groups ``data`` and ``meta``; every array in ``data``
has one row per frame of all recordings; ``meta/episode_ends`` (int64) states where each ends.
Pictures are (N, H, W, 3) uint8. One text per recording is stored in ``meta``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import zarr
from numcodecs import Blosc

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.calibration import calibration_record
from surg_recording.datasets import pictures
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.formats.frame_arrays import check_frames, put_frames
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

STORE = "replay.zarr"
_PART = "part.zarr"
_ZARR_2 = hasattr(zarr, "DirectoryStore")  # of Debian 12; later versions have other names
_DEFAULT = "default" if _ZARR_2 else "auto"  # zarr's own compressor
_COMPRESSOR = Blosc("zstd", clevel=3, shuffle=Blosc.BITSHUFFLE)
_ROWS = 4096
"""Rows per chunk of a table."""


class DiffusionPolicy(Exporter):
    """diffusion_policy."""

    name = "diffusion_policy"
    title = "diffusion_policy (Zarr, format 2)"
    needs: ClassVar[Mapping[str, str]] = {
        "zarr": "Debian: python3-zarr; pip install 'surg_recording[zarr]'"
    }

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """One recording as a store of its own."""
        path = folder / _PART
        root = _new(path)
        features = [feature for feature in sampled.features if feature.dtype != "string"]
        for feature in features:
            stored = _create(root, feature, sampled.columns.get(feature.name), sampled.grid.frames)
            if feature.is_video:
                put_frames(stored, sampled, feature, options)
        again = zarr.open_group(str(path), mode="r")
        for feature in features:
            if feature.is_video:
                check_frames(again[_key(feature)], path, sampled, feature, options)
            elif not np.array_equal(again[_key(feature)][:], sampled.columns[feature.name]):
                raise EpisodeError(f"{path}: {feature.name}: read back something else")

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Concatenate the recordings; pictures are chunks of one frame, so files are only moved."""
        root = _new(out / STORE)
        data, meta = root.create_group("data"), root.create_group("meta")
        ends = np.cumsum([part.frames for part in dataset.parts]).astype(np.int64)
        sources = [zarr.open_group(str(p.folder / _PART), mode="r") for p in dataset.parts]
        for feature in dataset.features:
            name = _key(feature)
            if feature.is_video:
                _create(data, feature, None, int(ends[-1]))
                self._place_chunks(dataset.parts, name, out / STORE / "data" / name)
            elif feature.dtype != "string":
                values = np.concatenate([source[name][:] for source in sources])
                _create(data, feature, values, int(ends[-1]))
        _array(meta, "episode_ends", ends)
        _array(meta, "instruction", np.array([part.instruction for part in dataset.parts]))
        _array(meta, "kind", np.array([part.kind for part in dataset.parts]))
        places, calibrations = calibration_record.grouped([part.about for part in dataset.parts])
        root.attrs.update(
            calibrations=calibrations,
            calibration_of_episode=places,
            fps=dataset.options.fps,
            robot_type=dataset.robot_type,
            splits={name: list(ends) for name, ends in dataset.splits.items()},
            state=_key_of(dataset, STATE_KEY),
            action=_key_of(dataset, ACTION_KEY),
        )

    def _place_chunks(self, parts: tuple[Part, ...], name: str, target: Path) -> None:
        first = 0
        for part in parts:
            for number in range(part.frames):
                chunk = part.folder / _PART / name / f"{number}.0.0.0"
                if chunk.exists():  # a frame of zeros alone is not stored
                    pictures.link_or_copy(chunk, target / f"{first + number}.0.0.0")
            first += part.frames

    def validate(self, out: Path) -> Report:
        """Open the store as ReplayBuffer does, and read everything."""
        report = Report(self.name, out)
        with report.reading():
            root = zarr.open_group(str(out / STORE), mode="r")
            stated = json.loads((out / STORE / ".zgroup").read_text("utf-8"))
            if stated != {"zarr_format": 2}:
                report.errors.append(f"zarr format is {stated}, not 2")
            ends = root["meta"]["episode_ends"][:]
            if ends.dtype != np.int64 or not (np.diff(ends, prepend=0) > 0).all():
                report.errors.append("meta/episode_ends does not increase")
            report.recordings, report.frames = len(ends), int(ends[-1])
            for name, stored in root["data"].arrays():
                self._validate(name, stored, report)
            report.errors += _off_grid(root, ends)
            report.facts["splits"] = dict(root.attrs["splits"])
            report.facts["data"] = {n: list(a.shape) for n, a in root["data"].arrays()}
        return report

    def _validate(self, name: str, stored: Any, report: Report) -> None:
        if stored.shape[0] != report.frames:
            report.errors.append(f"data/{name}: {stored.shape[0]} rows, not {report.frames}")
            return
        if stored.dtype == np.uint8:
            for number in range(stored.shape[0]):
                stored[number]
        elif not np.isfinite(stored[:]).all():
            report.errors.append(f"data/{name}: holds values that are no numbers")


def _new(path: Path) -> Any:
    if not _ZARR_2:
        return zarr.open_group(str(path), mode="w", zarr_format=2)
    return zarr.open_group(zarr.DirectoryStore(str(path)), mode="w")


def _stored(group: Any, name: str, values: npt.NDArray[Any], compressor: Any, **how: Any) -> Any:
    """An array of a group that holds these values."""
    if _ZARR_2:
        return group.array(name, values, compressor=compressor, **how)
    stored = group.create_array(
        name, shape=values.shape, dtype=values.dtype, compressors=compressor, **how
    )
    stored[...] = values
    return stored


def _create(group: Any, feature: Feature, values: npt.NDArray[Any] | None, frames: int) -> Any:
    """A described array of a feature; that of a video is filled later."""
    if feature.is_video:
        make = group.create_dataset if _ZARR_2 else group.create_array
        stored = make(
            _key(feature),
            shape=(frames, *feature.shape),
            chunks=(1, *feature.shape),
            dtype=np.uint8,
            fill_value=0,
            **{"compressor" if _ZARR_2 else "compressors": _COMPRESSOR},
        )
    else:
        assert values is not None
        chunks = (_ROWS, *values.shape[1:])
        stored = _stored(group, _key(feature), values, _DEFAULT, chunks=chunks)
    stated = feature.describe()
    kept = ("names", "units", "frame", "method", "text", "privileged")
    stored.attrs.update(feature=feature.name, **{key: stated[key] for key in kept})
    return stored


def _array(group: Any, name: str, values: npt.NDArray[Any]) -> None:
    _stored(group, name, values, None, chunks=values.shape)


def _key(feature: Feature) -> str:
    """Name of an array: ``state``, ``action``, the camera, else unchanged."""
    if feature.name == STATE_KEY:
        return "state"
    return feature.camera if feature.is_video else feature.name


def _key_of(dataset: Dataset, name: str) -> str | None:
    return next((_key(feature) for feature in dataset.features if feature.name == name), None)


def _off_grid(root: Any, ends: npt.NDArray[np.int64]) -> list[str]:
    """Errors for recordings whose grid times are not 1 / fps apart (rounded to a nanosecond)."""
    if "timing.grid_ns" not in root["data"]:
        return []
    times, fps = root["data"]["timing.grid_ns"][:], root.attrs["fps"]
    errors = []
    for number, end in enumerate(ends):
        begin = ends[number - 1] if number else 0
        off = times[begin:end] - times[begin] - np.arange(end - begin) * (1e9 / fps)
        if np.abs(off).max() > 1:
            errors.append(f"recording {number}: its frames are not {1 / fps:g} s apart")
    return errors
