"""Picture streams of the console: pairs the two eyes and encodes each watched layout and codec."""

from __future__ import annotations

import time
from dataclasses import dataclass

from surg_console.web.codec import (
    CODECS,
    Codec,
    CodecError,
    Image,
    frame_of,
    half_size,
    profile_of,
)
from surg_console.web.picture_packet import Packet

EYES = {
    "left": ("left",),
    "stereo": ("left", "right"),
    "left_half": ("left",),
    "stereo_half": ("left", "right"),
}
"""Cameras of each layout."""
SLACK_US = 20_000
"""[µs] So much sooner a picture may come: exposures are never quite even."""


@dataclass(frozen=True)
class CameraFrame:
    """One picture of one camera."""

    stamp_us: int  # exposure [µs]
    received_us: int  # receipt [µs]
    pixels: Image  # (height, width[, 3])
    encoding: str  # as in `sensor_msgs/Image`


class StereoPairer:
    """Keeps the newest frame of each eye and returns a set once all stamps agree."""

    def __init__(self, eyes: tuple[str, ...]) -> None:
        self._eyes = eyes
        self._newest: dict[str, CameraFrame] = {}

    def add(self, eye: str, frame: CameraFrame) -> tuple[CameraFrame, ...] | None:
        """Add a frame; returns the set that it completes, if any."""
        if eye not in self._eyes:
            return None
        self._newest[eye] = frame
        newest = (self._newest.get(other) for other in self._eyes)
        frames = tuple(f for f in newest if f is not None and f.stamp_us == frame.stamp_us)
        return frames if len(frames) == len(self._eyes) else None


class PictureStream:
    """One layout in one codec; restarts when the pictures change their size."""

    def __init__(self, layout: str, codec: str) -> None:
        self.layout, self.codec = layout, codec
        self._encoder: Codec | None = None
        self._key, self._seq = True, 0
        self._spacing_us, self._taken_us = 0, 0

    def request_key(self) -> None:
        """Make the next picture a key picture."""
        self._key = True

    def space(self, spacing: int) -> None:
        """Leave out what was exposed sooner than this after the last picture [ms]."""
        self._spacing_us = 1000 * spacing - SLACK_US

    def encode(self, frames: tuple[CameraFrame, ...]) -> Packet | None:
        """Encode one picture; None: it is left out, or the codec has kept it back.

        Raises:
            CodecError: The frames differ in size.
        """
        if 0 <= frames[0].stamp_us - self._taken_us < self._spacing_us and not self._key:
            return None
        self._taken_us = frames[0].stamp_us
        pixels = tuple(f.pixels for f in frames)
        if self.layout.endswith("_half"):
            pixels = tuple(half_size(each) for each in pixels)
        frame = frame_of(pixels, frames[0].encoding)
        size = (frame.width, frame.height)
        if self._encoder is None or self._encoder.size != size:
            self._encoder, self._key = Codec(self.codec, size), True
        data = self._encoder.encode(frame, frames[0].stamp_us, self._key)
        if not data:
            return None
        profile = profile_of(data) if self.codec == "h264" else (0, 0, 0)
        self._key = False
        self._seq += 1
        return Packet(
            self.layout,
            self.codec,
            self.codec == "jpeg" or any(profile),
            profile,
            *size,
            self._seq,
            frames[0].stamp_us,
            max(f.received_us for f in frames),
            time.time_ns() // 1000,
            data,
        )


def parse_line(line: str) -> tuple[str, dict[tuple[str, str], int]]:
    """One command of the server: ``want`` or ``key``, and its layouts and codecs.

    With each stands the time between two pictures [ms] (``key``: 0).

    Raises:
        CodecError: It is not a command.
    """
    word, *items = line.split()
    streams = {}
    for item in items:
        layout, codec, spacing = (*item.split(":"), "0", "")[:3]
        streams[layout, codec] = int(spacing) if spacing.isdecimal() else -1
    known = all(a in EYES and b in CODECS and ms >= 0 for (a, b), ms in streams.items())
    if word not in ("want", "key") or not known:
        raise CodecError(f"{line!r}; allowed: want or key, with layouts and codecs")
    return word, streams
