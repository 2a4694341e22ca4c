"""A calibration walk as a recording: at each rest a pair of pictures, and all arms' joints."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.recording.recording_synthetic import Synthetic, cycle, header
from helpers.recording.stereo_recording import EYES, camera_info, image
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import LEFT, RIGHT
from surg_recording.episode.episode_recorder import Recording

Joints = Mapping[str, NDArray[np.float64]]
Rest = tuple[Joints, tuple[NDArray[np.uint8], ...]]
REST_NS, AROUND_NS = 500_000_000, 20_000_000


def record_walk(folder: Path, cell: surg_core.Cell, rests: Iterable[Rest]) -> Path:
    """An episode with a rest every half second; an arm that no rest states stays at home."""
    lenses = [load_lens(cell.folder / "calibration" / name) for name in (LEFT, RIGHT)]
    recording = Recording(
        folder,
        mode="lockstep",
        arms=list(cell.arms),
        cameras=list(EYES),
        manifest={"run": {}, "versions": {"surg_recording": "test"}},
        min_free_bytes=0,
        video_quality="18",
    )
    number = 0
    for count, (joints, pictures) in enumerate(rests, start=1):
        for stamp in range(count * REST_NS - AROUND_NS, count * REST_NS + 2 * AROUND_NS, AROUND_NS):
            number += 1
            for name, arm in cell.arms.items():
                message = cycle(Synthetic(), number, 1)
                q = np.asarray(joints.get(name, arm.robot.home))
                message.header, message.q = header(stamp), q.tolist()
                recording.cycle(name, message, stamp)
        for eye, picture in zip(EYES, pictures, strict=True):
            recording.image(eye, image(count * REST_NS, picture), count * REST_NS)
    models = {eye: camera_info(lens) for eye, lens in zip(EYES, lenses, strict=True)}
    return recording.close({"camera_info": models})


def rests_of(folder: Path, cell: surg_core.Cell) -> Iterator[Rest]:
    """The rests of a folder of views."""
    with (folder / "views.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            joints = {
                name: np.array([float(row[f"{name}/{joint}"]) for joint in arm.robot.joint_names])
                for name, arm in cell.arms.items()
                if f"{name}/{arm.robot.joint_names[0]}" in row
            }
            files = (folder / f"{row['view']}_{eye}.png" for eye in ("left", "right"))
            pictures = (cv2.imread(str(file), cv2.IMREAD_COLOR) for file in files)
            yield joints, tuple(np.asarray(each[..., ::-1], np.uint8) for each in pictures)
