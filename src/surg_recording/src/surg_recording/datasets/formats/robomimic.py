"""HDF5 as robomimic reads it: ``demos.hdf5`` with ``data/demo_<n>`` and split masks.

Facts about that reader (``SequenceDataset``): demos are sorted by the number behind ``demo_``;
``attrs["num_samples"]`` of each; ``actions``, ``rewards``, ``dones``; ``obs/<key>`` and, on
request, ``next_obs/<key>``; ``data.attrs["env_args"]`` as JSON with ``env_name``, ``type``,
``env_kwargs``; ``mask/<split>`` holds names of demos. Keys hold no "/". Actions are in SI units, so
robomimic must normalise them itself (``action_config``: ``min_max``); ``data.attrs`` has the range.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.datasets import schema
from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.formats import hdf5
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

FILE = "demos.hdf5"
_PART = "demo.hdf5"
_GYM = 2
"""robomimic's EnvType of an environment made by gymnasium."""
_MASKS = {"val": "valid"}
"""Splits that have another name in robomimic."""


class Robomimic(Exporter):
    """robomimic."""

    name = "robomimic"
    title = "robomimic (HDF5, one file)"
    needs: ClassVar[Mapping[str, str]] = hdf5.NEEDS

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """One demo in a file of its own."""
        path = folder / _PART
        n = sampled.grid.frames
        columns = sampled.columns
        if ACTION_KEY not in columns or STATE_KEY not in columns:
            raise EpisodeError(
                "format robomimic needs action and observation.state: do not --drop them"
            )
        last = np.arange(n) == n - 1
        rewards = columns.get("next.reward", np.zeros(n, np.float32))
        by_place = {_place(feature): feature for feature in sampled.features}
        with h5py.File(path, "w") as root:
            demo = root.create_group("demo")
            demo.attrs["num_samples"] = n
            demo["rewards"] = rewards
            demo["dones"] = last.astype(np.int64)
            hdf5.put_all(demo, by_place, sampled, options)
            for place, feature in by_place.items():
                if place.startswith("obs/") and not feature.is_video:
                    values = columns[feature.name]
                    hdf5.put(demo, f"next_{place}", np.concatenate([values[1:], values[-1:]]))
        with h5py.File(path, "r") as root:
            hdf5.check_all(root["demo"], by_place, sampled, options)

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Copy the demos into one file, without decompressing their pictures."""
        low, high = [], []
        with h5py.File(out / FILE, "w", libver="latest") as root:
            data, mask = root.create_group("data"), root.create_group("mask")
            for index, part in enumerate(dataset.parts):
                with h5py.File(part.folder / _PART, "r") as source:
                    source.copy("demo", data, name=f"demo_{index}")
                demo = data[f"demo_{index}"]
                for feature in schema.videos_of(dataset.features):
                    _next_pictures(demo, _place(feature))
                low.append(demo["actions"][()].min(axis=0))
                high.append(demo["actions"][()].max(axis=0))
            data.attrs["total"] = dataset.frames
            data.attrs["fps"] = dataset.options.fps
            data.attrs["robot_type"] = dataset.robot_type
            data.attrs["actions_min"] = np.min(low, axis=0)
            data.attrs["actions_max"] = np.max(high, axis=0)
            data.attrs["env_args"] = json.dumps(
                {
                    "env_name": str(dataset.parts[0].about.get("task") or dataset.name),
                    "env_version": "1",
                    "type": _GYM,
                    "env_kwargs": {},
                }
            )
            for split, (begin, end) in dataset.splits.items():
                names = [f"demo_{index}" for index in range(begin, end)]
                mask[_MASKS.get(split, split)] = np.array(names, dtype="S")

    def validate(self, out: Path) -> Report:
        """Open the file as robomimic's reader does, and read everything."""
        report = Report(self.name, out)
        with report.reading(), h5py.File(out / FILE, "r", libver="latest", swmr=True) as root:
            self._validate(root, report)
        return report

    def _validate(self, root: h5py.File, report: Report) -> None:
        data = root["data"]
        demos = sorted(data.keys(), key=lambda name: int(name[5:]))
        fps = data.attrs["fps"]
        for key in ("env_name", "type", "env_kwargs"):
            if key not in json.loads(data.attrs["env_args"]):
                report.errors.append(f"env_args has no {key}")
        for number, name in enumerate(demos):
            demo = data[name]
            n = int(demo.attrs["num_samples"])
            if name != f"demo_{number}":
                report.errors.append(f"{name}: demos must be numbered without gaps")
            if set(demo["obs"]) != set(data[demos[0]]["obs"]) or set(demo["next_obs"]) != set(
                demo["obs"]
            ):
                report.errors.append(f"{name}: other observations than the first demo")
            every = [demo[key] for key in ("actions", "rewards", "dones", "timestamp")]
            every += [*demo["obs"].values(), *demo["next_obs"].values()]
            report.errors += hdf5.read_all(every, n)
            if not np.array_equal(demo["timestamp"][()], np.arange(n) / fps):
                report.errors.append(f"{name}: timestamp is not on the grid")
            report.recordings += 1
            report.frames += n
        if report.frames != data.attrs["total"]:
            report.errors.append(
                f"{report.frames} frames, data.attrs['total'] is {data.attrs['total']}"
            )
        masked = [name.decode() for mask in root["mask"].values() for name in mask[()]]
        if sorted(masked) != sorted(demos):
            report.errors.append("the masks do not hold every demo once")
        report.facts["splits"] = {name: len(mask) for name, mask in root["mask"].items()}
        report.facts["observations"] = {
            k: list(v.shape[1:]) for k, v in data[demos[0]]["obs"].items()
        }


def _place(feature: Feature) -> str:
    """Path of a feature in a demo."""
    if feature.name == ACTION_KEY:
        return "actions"
    if feature.is_video:
        return f"obs/{feature.camera}_image"
    head, _, rest = feature.name.partition(".")
    measured = head == "observation" and feature.dtype.startswith("float")
    return f"obs/{rest}" if measured else f"extra/{feature.name}"


def _next_pictures(demo: h5py.Group, place: str) -> None:
    """``next_obs`` of a camera: a view of ``obs``, one frame later; the last frame repeats."""
    pictures = demo[place]
    n = pictures.shape[0]
    layout = h5py.VirtualLayout(pictures.shape, pictures.dtype)
    source = h5py.VirtualSource(".", pictures.name, pictures.shape, pictures.dtype)
    layout[: n - 1] = source[1:]
    layout[n - 1 :] = source[n - 1 :]
    demo.create_virtual_dataset(f"next_{place}", layout)
