"""Depth of a recorded episode, computed afterwards: a video of 16-bit values, a film, figures.

``endoscope_depth.mp4`` holds tenths of a millimetre as 16-bit grey PNG pictures, 0 where the depth
is unknown, in the left rectified eye; ``endoscope_depth.csv`` is its sidecar with the stamps of the
pairs. ``surg_recording.video.exact_values.read`` reads it.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from surg_perception.depth import depth_preview
from surg_perception.depth.recorded_eyes import RecordedEyes
from surg_perception.depth.rectification import Picture
from surg_perception.depth.stereo_depth import DepthPicture, StereoDepth
from surg_perception.depth.stereo_matcher import FAR, NEAR
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import film, video_encoder

FORMAT = "surg_depth/1"
NAME = "endoscope_depth"
UNIT = 1e-4
"""[m] of one step of a 16-bit value."""
FILM_PICTURES = 180
"""Of the preview: 12 s."""
_PARTIAL = ".partial"


@dataclass(frozen=True)
class DepthOptions:
    """How depth is computed.

    Attributes:
        method: As for :class:`StereoDepth`; size, near and far too.
        size: Width and height of the rectified pictures [px]; None: of the videos.
        near: Smallest distance [m].
        far: Largest distance [m].
    """

    method: str = "sgbm_8"
    size: tuple[int, int] | None = None
    near: float = NEAR
    far: float = FAR


def compute(
    eyes: RecordedEyes,
    out: Path,
    options: DepthOptions | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Compute the depth of all pairs and write the folder ``out``; returns ``depth.json``.

    Args:
        eyes: Of the episode.
        out: A folder that does not exist yet. It appears when everything in it is complete.
        options: See there.
        progress: Called with the share that is done.

    Raises:
        EpisodeError: ``out`` exists, a video cannot be read, or nothing can be written.
        ConfigError: The lenses make no pair.
        MatcherError: The method cannot be used.
    """
    options = options or DepthOptions()
    depth = StereoDepth(*eyes.lenses, options.size, options.method, options.near, options.far)
    if out.exists():
        raise EpisodeError(f"{out}: is there already; remove it, or choose another --out")
    partial = out.with_name(out.name + _PARTIAL)
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        figures = _Run(eyes, depth, options).write(partial, progress)
        (partial / "depth.json").write_text(json.dumps(figures, indent=1) + "\n", "utf-8")
        partial.rename(out)
    except OSError as problem:
        raise EpisodeError(f"{out}: cannot be written: {problem}") from problem
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return figures


class _Run:
    """One computation."""

    def __init__(self, eyes: RecordedEyes, depth: StereoDepth, options: DepthOptions) -> None:
        self._eyes, self._depth, self._options = eyes, depth, options
        self._count = len(eyes.stamps)
        self._shown: tuple[float, float] | None = None
        self._film: list[Picture] = []
        self._middle: Picture | None = None
        self._known: list[float] = []
        self._medians: list[float] = []
        self._spent: list[float] = []

    def write(self, folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
        """Compute and write all files but ``depth.json``; returns its content."""
        video, sidecar = folder / f"{NAME}.mp4", folder / f"{NAME}.csv"
        encoder = video_encoder.Encoder(str(video), str(sidecar), "ultrafast", "lossless")
        try:
            for number, pair in enumerate(self._eyes.pairs()):
                begun = time.perf_counter()
                found = self._depth.look(pair.left, pair.right)
                self._spent.append(time.perf_counter() - begun)
                height, width = found.depth.shape
                values = tenths_of_mm(found).view(np.uint8).reshape(height, width, 2)
                pixels = video_encoder.ENCODINGS["16UC1"]
                encoder.add(values, pixels, pair.stamp_ns, pair.receive_ns, 0)
                self._keep(number, found)
                progress((number + 1) / self._count)
        finally:
            encoder.close()
        if self._middle is not None:
            bgr = cv2.cvtColor(self._middle, cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(folder / "depth.png"), bgr)
        film.write(iter(self._film), len(self._film), folder / "depth.mp4")
        return self._figures()

    def _keep(self, number: int, found: DepthPicture) -> None:
        self._known.append(found.known)
        if found.known:
            self._medians.append(float(np.nanmedian(found.depth)))
        if self._shown is None and found.known > 0.1:
            self._shown = depth_preview.shown_range(found.depth)
        step = max(1, -(-self._count // FILM_PICTURES))
        if number % step and number != self._count // 2:
            return
        near, far = self._shown or (self._options.near, self._options.far)
        picture = depth_preview.beside(found.left, found.depth, near, far)
        if number % step == 0:
            self._film.append(picture)
        if number == self._count // 2:
            self._middle = picture

    def _figures(self) -> dict[str, Any]:
        geometry, manifest = self._depth.geometry, self._eyes.episode.manifest
        seen = np.percentile(self._medians, (5, 95)).tolist() if self._medians else None
        return {
            "format": FORMAT,
            "episode": str(manifest.get("name") or self._eyes.episode.folder.name),
            "unit_m": UNIT,
            "frame": "left eye, rectified",
            "method": Path(self._options.method).name,
            "near_m": self._options.near,
            "far_m": self._options.far,
            "size": list(geometry.size),
            "f": [geometry.f, geometry.fy],
            "c": [geometry.cx, geometry.cy],
            "baseline_m": geometry.baseline,
            "pairs": len(self._known),
            "unpaired": self._eyes.unpaired,
            "known": float(np.mean(self._known)),
            "median_depth_m": seen,
            "seconds_per_pair": float(np.median(self._spent)),
            "video_quality": self._eyes.quality,
        }


def tenths_of_mm(found: DepthPicture) -> np.ndarray:
    """Depth as 16-bit numbers of :data:`UNIT` (h, w), little-endian; 0: unknown."""
    steps = np.round(found.depth / np.float32(UNIT))
    fits = np.isfinite(steps) & (steps >= 1) & (steps <= 65535)
    return np.where(fits, steps, 0).astype("<u2")
