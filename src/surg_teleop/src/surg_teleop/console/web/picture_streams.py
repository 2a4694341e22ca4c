"""Which pictures are made of what the cameras send: pairs the eyes, feeds one codec per wish."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from surg_teleop.console.web.codec import (
    CODECS,
    Codec,
    CodecError,
    Image,
    frame_of,
    image_of,
    profile_of,
)
from surg_teleop.console.web.picture_packet import Packet

EYES = {"left": ("left",), "stereo": ("left", "right")}
"""Cameras of each layout."""


@dataclass(frozen=True)
class Shot:
    """One picture of one camera, as it came.

    Attributes:
        stamp_us: Exposure [µs].
        received_us: [µs].
        pixels: (height, width[, 3]).
        encoding: As in `sensor_msgs/Image`.
    """

    stamp_us: int
    received_us: int
    pixels: Image
    encoding: str

    @classmethod
    def of(
        cls,
        stamp_us: int,
        received_us: int,
        data: bytes,
        size: tuple[int, int],
        step: int,
        encoding: str,
    ) -> Shot:
        """A shot of a ROS image.

        Raises:
            CodecError: The image does not add up.
        """
        return cls(stamp_us, received_us, image_of(data, *size, step, encoding), encoding)


class Pairer:
    """Keeps the newest shot of each eye; gives a set out once all stamps agree."""

    def __init__(self, eyes: tuple[str, ...]) -> None:
        self._eyes = eyes
        self._newest: dict[str, Shot] = {}

    def add(self, eye: str, shot: Shot) -> tuple[Shot, ...] | None:
        """Take a shot in; returns the whole set when it completes one."""
        if eye not in self._eyes:
            return None
        self._newest[eye] = shot
        found = [self._newest.get(each) for each in self._eyes]
        whole = tuple(each for each in found if each is not None and each.stamp_us == shot.stamp_us)
        return whole if len(whole) == len(self._eyes) else None


class Stream:
    """One layout in one codec; starts anew when the pictures change their size.

    Args:
        layout: "left" or "stereo".
        codec: "h264" or "jpeg".
        wall_us: Wall clock [µs].
    """

    def __init__(self, layout: str, codec: str, wall_us: Callable[[], int] | None = None) -> None:
        self.layout, self.codec = layout, codec
        self._wall_us = wall_us or (lambda: time.time_ns() // 1000)
        self._encoder: Codec | None = None
        self._key, self._seq = True, 0

    def ask_key(self) -> None:
        """The next picture must be decodable by itself."""
        self._key = True

    def encode(self, shots: tuple[Shot, ...]) -> Packet | None:
        """One picture; None: the codec kept it back.

        Raises:
            CodecError: The shots do not fit together.
        """
        frame = frame_of(tuple(shot.pixels for shot in shots), shots[0].encoding)
        size = (frame.width, frame.height)
        if self._encoder is None or self._encoder.size != size:
            self._encoder, self._key = CODECS[self.codec](*size), True
        data = self._encoder.encode(frame, shots[0].stamp_us, self._key)
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
            shots[0].stamp_us,
            max(shot.received_us for shot in shots),
            self._wall_us(),
            data,
        )


def parse_line(line: str) -> tuple[str, frozenset[tuple[str, str]]]:
    """One line of the server: a word and the layouts and codecs that it is about.

    Raises:
        CodecError: It is none.
    """
    word, *wishes = line.split()
    pairs = frozenset((w.partition(":")[0], w.partition(":")[2]) for w in wishes)
    if word not in ("want", "key") or any(a not in EYES or b not in CODECS for a, b in pairs):
        raise CodecError(f"{line!r}; allowed: want or key, with layouts and codecs")
    return word, pairs
