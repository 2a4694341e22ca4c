"""Records pairs of pictures as an episode of a stereo endoscope, without ROS."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from helpers.recording.recording_synthetic import header
from surg_core.lens_file import Lens
from surg_recording.episode.episode_recorder import Recording

EYES = ("endoscope_left", "endoscope_right")
FRAME_NS = 50_000_000


def camera_info(lens: Lens) -> dict[str, Any]:
    """A lens as a manifest states it."""
    return {**lens.camera_info, "frame_id": lens.camera_name}


def image(ns: int, picture: np.ndarray) -> SimpleNamespace:
    """A message-like rgb8 image."""
    height, width, _ = picture.shape
    data = np.ascontiguousarray(picture).tobytes()
    return SimpleNamespace(
        header=header(ns), width=width, height=height, step=3 * width, encoding="rgb8", data=data
    )


def record_pairs(
    folder: Path,
    pairs: Iterable[tuple[np.ndarray, ...]],
    models: dict[str, Any],
    quality: str = "18",
    cameras: tuple[str, ...] = EYES,
    late: int = 0,
) -> Path:
    """Record pairs (h, w, 3), rgb8; returns the finished episode.

    Args:
        folder: Of the episode.
        pairs: Pictures of each camera, at 20/s.
        models: ``camera_info`` of the manifest.
        quality: x264's crf, or ``lossless``.
        cameras: Names.
        late: The right eye's stamps are this much later [ns].
    """
    recording = Recording(
        folder,
        mode="lockstep",
        arms=[],
        cameras=list(cameras),
        manifest={"run": {}, "versions": {"surg_recording": "test"}},
        min_free_bytes=0,
        video_quality=quality,
    )
    for number, pictures in enumerate(pairs, start=1):
        for camera, picture in zip(cameras, pictures, strict=False):
            stamp = number * FRAME_NS + (late if camera == EYES[1] else 0)
            recording.image(camera, image(stamp, picture), stamp)
    return recording.close({"camera_info": models})
