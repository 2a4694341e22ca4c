"""Parameters of the recorder. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_recording.episode.episode_writer import MIN_FREE_BYTES
from surg_recording.video.video_encoder import CRF, LOSSLESS
from surg_ros.camera_topic import camera_topic
from surg_ros.params import ParamError, dictionary, flag, names, one_of, path, whole

MODES = ("lockstep", "freerun")
PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow")


@dataclass(frozen=True)
class Settings:
    """Parameters of the node ``/recorder``.

    Attributes:
        out: Folder that the episode is written to.
        cell: Path of the cell; None: no cell is described.
        mode: ``lockstep`` or ``freerun``.
        arms: Names of the recorded arms.
        cameras: Topics of raw or compressed images, or names: ``a_b`` of ``/a/b/image_raw``.
        topics: Names and patterns of further topics.
        run_info: Facts about the run, for the manifest: robot, motion, task, operator, ….
        autostart: Record from the first message; False: wait for /record/record.
        min_free_bytes: Stop with less free space on the disk [bytes].
        video_preset: Encoder preset.
        video_crf: Quality of videos: crf of x264, 0 (best) to 51.
        video_lossless: Keep every pixel as it was, whatever ``video_crf`` says.
    """

    out: Path = path()
    cell: Path | None = path(None)
    mode: str = one_of(MODES, "lockstep")
    arms: tuple[str, ...] = names(("PSM1",), least=1)
    cameras: tuple[str, ...] = names(())
    topics: tuple[str, ...] = names(())
    run_info: dict[str, Any] = dictionary()
    autostart: bool = flag(True)
    min_free_bytes: int = whole(0, 10**19, MIN_FREE_BYTES)
    video_preset: str = one_of(PRESETS, "ultrafast")
    video_crf: int = whole(0, 51, CRF)
    video_lossless: bool = flag(False)

    def __post_init__(self) -> None:
        """Strips slashes off the arms' names; a ParamError if a camera is named twice."""
        object.__setattr__(self, "arms", tuple(name.strip("/") for name in self.arms))
        if len(self.camera_topics) != len(self.cameras):
            raise ParamError("cameras", list(self.cameras), "each camera once, by name or by topic")

    @property
    def video_quality(self) -> str:
        """Quality of videos, for ``episode_recorder.Recording``."""
        return LOSSLESS if self.video_lossless else str(self.video_crf)

    @property
    def camera_topics(self) -> dict[str, str]:
        """Topic of each camera, by name."""
        return dict(camera_topic(name) for name in self.cameras)
