"""HDF5 as ACT and ALOHA read it: ``episode_<n>.hdf5`` per recording.

Facts about that reader (``EpisodicDataset``): attribute ``sim``; ``/action``,
``/observations/qpos``, ``/observations/qvel``, ``/observations/images/<camera>`` as (N, H, W, 3)
uint8, one frame per chunk. With ``sim`` false it shifts actions by one frame against observations,
to correct for recorders that store the action *after* the observation it led to. Ours are stored
with the observation they answer, so ``sim`` is always true (``simulated`` states the source).
``qpos`` is ``observation.state``. Recordings differ in length, as in ACT's later versions; the
original stacks them and needs equal lengths, see ``attrs["frames"]``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np

from surg_core.contract import ACTION_KEY, STATE_KEY
from surg_recording.datasets import pictures, schema
from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.formats import hdf5
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

_FILE = "episode.hdf5"
_OBSERVATIONS = {
    "observations/qpos": STATE_KEY,
    "observations/qvel": "observation.joint_velocities",
}


class Act(Exporter):
    """ACT, ALOHA."""

    name = "act"
    title = "ACT / ALOHA (HDF5, one file per recording)"
    needs: ClassVar[Mapping[str, str]] = hdf5.NEEDS

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """The recording's whole file."""
        path = folder / _FILE
        places = arrays(sampled)
        with h5py.File(path, "w") as root:
            root.attrs["sim"] = True
            root.attrs["simulated"] = bool(sampled.candidate.about["simulated"])
            root.attrs["fps"] = sampled.grid.fps
            root.attrs["frames"] = sampled.grid.frames
            hdf5.put_all(root, places, sampled, options)
        with h5py.File(path, "r") as root:
            hdf5.check_all(root, places, sampled, options)

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Number the files; ``dataset.json`` has the splits."""
        for index, part in enumerate(dataset.parts):
            pictures.link_or_copy(part.folder / _FILE, out / f"episode_{index}.hdf5")
        stated = {
            "episodes": len(dataset.parts),
            "episode_len": [part.frames for part in dataset.parts],
            "camera_names": [video.camera for video in schema.videos_of(dataset.features)],
            "state_dim": _size(dataset, STATE_KEY),
            "action_dim": _size(dataset, ACTION_KEY),
            "robot_type": dataset.robot_type,
            "splits": {name: list(ends) for name, ends in dataset.splits.items()},
        }
        (out / "dataset.json").write_text(json.dumps(stated, indent=1) + "\n", "utf-8")

    def validate(self, out: Path) -> Report:
        """Open every file as ACT's reader does, and read everything."""
        report = Report(self.name, out)
        with report.reading():
            stated: dict[str, Any] = json.loads((out / "dataset.json").read_text("utf-8"))
            for index in range(stated["episodes"]):
                with h5py.File(out / f"episode_{index}.hdf5", "r") as root:
                    _validate(root, stated, stated["episode_len"][index], report)
            extra = len(list(out.glob("episode_*.hdf5"))) - stated["episodes"]
            if extra:
                report.errors.append(f"{extra} files more than dataset.json says")
            report.facts["splits"] = stated["splits"]
        return report


def _validate(root: h5py.File, stated: Mapping[str, Any], length: int, report: Report) -> None:
    name = Path(root.filename).name
    action, qpos = root["action"], root["observations/qpos"]
    series = [action, *(root[key] for key in _OBSERVATIONS if key in root), root["timestamp"]]
    images = [root[f"observations/images/{camera}"] for camera in stated["camera_names"]]
    report.errors += hdf5.read_all([*series, *images], length)
    if "sim" not in root.attrs:
        report.errors.append(f"{name}: no attribute 'sim'")
    shapes = (action.shape[1:], qpos.shape[1:])
    if shapes != ((stated["action_dim"],), (stated["state_dim"],)):
        report.errors.append(f"{name}: action and qpos have shapes {shapes}")
    if not np.array_equal(root["timestamp"][()], np.arange(length) / root.attrs["fps"]):
        report.errors.append(f"{name}: timestamp is not on the grid")
    for image in images:
        if image.dtype != np.uint8 or image.ndim != 4 or image.shape[3] != 3:
            report.errors.append(f"{name}: {image.name} is {image.dtype} {image.shape}")
    report.recordings += 1
    report.frames += length


def arrays(sampled: Sampled) -> dict[str, Feature]:
    """Place in the file → feature."""
    features = {feature.name: feature for feature in sampled.features}
    named = {**_OBSERVATIONS, "action": ACTION_KEY}
    if not any(sampled.candidate.layout.joints):
        del named["observations/qvel"]  # of another program, which recorded no joints
    missing = [name for name in named.values() if name not in features]
    if missing:
        raise EpisodeError(f"format act needs {', '.join(missing)}: do not --drop it")
    places = {place: features[name] for place, name in named.items()}
    for name, feature in features.items():
        if feature.is_video:
            places[f"observations/images/{feature.camera}"] = feature
        elif name not in named.values():
            places[f"extra/{name}"] = feature
    return places


def _size(dataset: Dataset, name: str) -> int:
    """Length of a feature's vector."""
    return next(len(feature.names) for feature in dataset.features if feature.name == name)
