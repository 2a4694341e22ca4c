"""HDF5 as ACT and ALOHA read it: ``episode_<n>.hdf5`` per recording.

Facts about that reader (``EpisodicDataset``): attribute ``sim``; ``/action``,
``/observations/qpos``, ``/observations/qvel``, ``/observations/images/<camera>`` as (N, H, W, 3)
uint8, one frame per chunk. With ``sim`` false it shifts actions by one frame against observations,
to correct for recorders that store the action *after* the observation it led to; ours stand beside
the observation they answer, so ``sim`` is true whatever was recorded (``simulated`` says which).
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
from surg_recording.datasets import hdf5, pictures, schema
from surg_recording.datasets.exporter import Dataset, Exporter, Report
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.sampling import Sampled
from surg_recording.recording_errors import EpisodeError

_FILE = "episode.hdf5"
_VELOCITIES = "observation.joint_velocities"


class Act(Exporter):
    """ACT, ALOHA."""

    name = "act"
    title = "ACT / ALOHA (HDF5, one file per recording)"
    needs: ClassVar[Mapping[str, str]] = hdf5.NEEDS

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """The recording's whole file."""
        path = folder / _FILE
        layout = arrays(sampled)
        with h5py.File(path, "w") as root:
            root.attrs["sim"] = True
            root.attrs["simulated"] = bool(sampled.candidate.about["simulated"])
            root.attrs["fps"] = sampled.grid.fps
            root.attrs["frames"] = sampled.grid.frames
            root.attrs["instruction"] = sampled.candidate.instruction
            root.attrs["kind"] = sampled.candidate.kind
            by_name = {feature.name: feature for feature in sampled.features}
            for place, name in layout.items():
                if by_name[name].is_video:
                    hdf5.put_pictures(root, place, sampled, by_name[name], options)
                else:
                    hdf5.put(root, place, sampled.columns[name], by_name[name])
            root["timestamp"] = sampled.grid.timestamps
        with h5py.File(path, "r") as root:
            for place, name in layout.items():
                if by_name[name].is_video:
                    hdf5.check_pictures(root[place], sampled, by_name[name], options)
                else:
                    hdf5.check_array(root[place], sampled.columns[name])
            hdf5.check_array(root["timestamp"], sampled.grid.timestamps)

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Number the files; ``dataset.json`` has the splits."""
        for index, part in enumerate(dataset.parts):
            pictures.place(part.folder / _FILE, out / f"episode_{index}.hdf5")
        stated = {
            "episodes": len(dataset.parts),
            "episode_len": [part.frames for part in dataset.parts],
            "camera_names": [
                camera_name(feature) for feature in schema.videos_of(dataset.features)
            ],
            "state_dim": len(_feature(dataset, STATE_KEY).names),
            "action_dim": len(_feature(dataset, ACTION_KEY).names),
            "robot_type": dataset.robot_type,
            "splits": {name: list(ends) for name, ends in dataset.splits.items()},
        }
        (out / "dataset.json").write_text(json.dumps(stated, indent=1) + "\n", "utf-8")

    def validate(self, out: Path) -> Report:
        """Open every file as ACT's reader does, and read everything."""
        report = Report(self.name, out)
        try:
            stated: dict[str, Any] = json.loads((out / "dataset.json").read_text("utf-8"))
            for index in range(stated["episodes"]):
                self._validate(out / f"episode_{index}.hdf5", stated, index, report)
            extra = len(list(out.glob("episode_*.hdf5"))) - stated["episodes"]
            if extra:
                report.errors.append(f"{extra} files more than dataset.json says")
            report.facts["splits"] = stated["splits"]
        except Exception as problem:  # damaged files fail in many ways
            report.errors.append(f"{type(problem).__name__}: {problem}")
        return report

    def _validate(self, path: Path, stated: Mapping[str, Any], index: int, report: Report) -> None:
        with h5py.File(path, "r") as root:
            length = stated["episode_len"][index]
            action, qpos = root["/action"], root["/observations/qpos"]
            images = [root[f"/observations/images/{name}"] for name in stated["camera_names"]]
            every = [action, qpos, root["/observations/qvel"], root["timestamp"], *images]
            report.errors += hdf5.same_length(path, every, length)
            if "sim" not in root.attrs:
                report.errors.append(f"{path.name}: no attribute 'sim'")
            shapes = (action.shape[1:], qpos.shape[1:])
            if shapes != ((stated["action_dim"],), (stated["state_dim"],)):
                report.errors.append(f"{path.name}: action and qpos have shapes {shapes}")
            for array in (action, qpos, root["/observations/qvel"]):
                if not np.isfinite(array[()]).all():
                    report.errors.append(
                        f"{path.name}: {array.name} holds values that are no numbers"
                    )
            if not np.array_equal(root["timestamp"][()], np.arange(length) / root.attrs["fps"]):
                report.errors.append(f"{path.name}: timestamp is not on the grid")
            for image in images:
                if image.dtype != np.uint8 or image.ndim != 4 or image.shape[3] != 3:
                    report.errors.append(
                        f"{path.name}: {image.name} is {image.dtype} {image.shape}"
                    )
                for number in range(length):  # every chunk can be unpacked
                    image[number]
            report.recordings += 1
            report.frames += length


def arrays(sampled: Sampled) -> dict[str, str]:
    """Place in the file → feature."""
    found = {
        "observations/qpos": STATE_KEY,
        "observations/qvel": _VELOCITIES,
        "action": ACTION_KEY,
    }
    have = {feature.name: feature for feature in sampled.features}
    missing = [name for name in found.values() if name not in have]
    if missing:
        raise EpisodeError(f"format act needs {', '.join(missing)}: do not --drop it")
    for name, feature in have.items():
        if feature.is_video:
            found[f"observations/images/{camera_name(feature)}"] = name
        elif name not in found.values():
            found[f"extra/{name}"] = name
    return found


def camera_name(feature: schema.Feature) -> str:
    """Name of a camera in the file, as in the recording."""
    return feature.camera


def _feature(dataset: Dataset, name: str) -> schema.Feature:
    return next(feature for feature in dataset.features if feature.name == name)
