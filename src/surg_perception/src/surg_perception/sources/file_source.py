"""``file:PATH``: a video, a folder of pairs, or the MP4s of an episode, at the pace of recording.

With the layout ``two``: ``file:LEFT+RIGHT``, a folder with ``left*`` and ``right*`` pictures, or an
episode's folder.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from surg_perception.capture.picture_source import (
    Grabbed,
    Image,
    PictureSource,
    SourceError,
    Wanted,
)
from surg_perception.sources import av_input
from surg_recording.video.colours import Colours, rotation_of

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
FOLDER_RATE = 30.0
"""[1/s] of a folder of pictures for which no rate is given."""
EPISODE_VIDEOS = ("endoscope_left.mp4", "endoscope_right.mp4")
NS = 1_000_000_000
LATE_NS = NS // 5


class FileSource(PictureSource):
    """Recorded pictures; their stamps are the times at which they are due.

    Options: ``rate`` (pictures per second, instead of the recording's times), ``loop``.
    """

    live = False
    keys = ("rate", "loop")

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self._where = f"endoscope.source: file:{address}"
        self._rate = wanted.rate
        if "rate" in options:
            if not re.fullmatch(r"\d{1,3}(\.\d+)?", options["rate"]) or not float(options["rate"]):
                raise SourceError(
                    "bad_address",
                    f"{self._where}: option rate: {options['rate']!r}; allowed: more than 0, at "
                    "most 999 pictures per second",
                )
            self._rate = float(options["rate"])
        self._eyes = self._files(wanted.folder)
        for files in self._eyes:
            for file in files:
                if not file.is_file():
                    raise SourceError("no_device", f"{self._where}: {file}: there is no such file")

    @classmethod
    def devices(cls, address: str) -> list[str]:
        """One: both eyes of a file are read together."""
        return [address]

    def _files(self, folder: Path) -> list[tuple[Path, ...]]:
        """The video, or the pictures, of each eye; one for both where they share a picture."""
        parts = [folder / part for part in self.address.split("+")]
        if len(parts) > 1 or not parts[0].is_dir():
            return [(part,) for part in parts]
        videos = [parts[0] / name for name in EPISODE_VIDEOS]
        if videos[0].is_file():
            return [(video,) for video in videos if video.is_file()]
        left, right = (_pictures(parts[0], eye) for eye in ("left", "right"))
        if len(left) != len(right):
            raise SourceError(
                "wrong_format",
                f"{self._where}: {len(left)} pictures left*, {len(right)} right*; allowed: as many "
                "of each",
            )
        found = [left, right] if left else [_pictures(parts[0], "")]
        if not found[0]:
            raise SourceError(
                "wrong_format",
                f"{self._where}: holds no pictures ({', '.join(PICTURES)}) and no "
                f"{EPISODE_VIDEOS[0]}",
            )
        return found

    def pictures(self) -> Iterator[Grabbed]:
        """The recording, over and over with ``loop``; then a SourceError ``ended``."""
        first = self.wanted.now()
        while True:
            due = first
            for offset, pictures in self._once():
                late = self.wanted.now() - first - offset
                if late > LATE_NS:  # the machine is too slow: go on from here
                    first += late
                due = first + offset
                self.wanted.sleep(max(0.0, -late / NS))
                yield Grabbed(due, self.wanted.now(), pictures)
            if "loop" not in self.options or due == first:
                break
            first = due + self._period
        raise SourceError("ended", f"{self._where}: the recording has ended")

    def _once(self) -> Iterator[tuple[int, tuple[Image, ...]]]:
        """Time from the first picture [ns], and the pictures of the eyes."""
        before, self._period = 0, round(NS / (self._rate or FOLDER_RATE))
        streams = [self._decoded(files) for files in self._eyes]
        for number, eyes in enumerate(zip(*streams, strict=False)):
            offset = round(number * NS / self._rate) if self._rate else eyes[0][0]
            if offset > before:
                self._period = offset - before
            before = offset
            yield offset, tuple(picture for _, picture in eyes)

    def _decoded(self, files: tuple[Path, ...]) -> Iterator[tuple[int, Image]]:
        if len(files) == 1 and files[0].suffix.lower() not in PICTURES:
            yield from self._video(files[0])
            return
        for number, file in enumerate(files):
            picture: Any = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if picture is None:
                raise SourceError("wrong_format", f"{self._where}: {file}: is no picture")
            colour = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
            yield round(number * NS / (self._rate or FOLDER_RATE)), colour

    def _video(self, file: Path) -> Iterator[tuple[int, Image]]:
        container = av_input.open_input(self._where, str(file))
        try:
            if not container.streams.video:
                raise SourceError("wrong_format", f"{self._where}: {file}: holds no video")
            first: int | None = None
            colours = Colours(rotation_of(file))
            for frame in container.decode(video=0):
                at = round((frame.pts or 0) * frame.time_base * NS)
                first = at if first is None else first
                yield at - first, colours(frame)
        finally:
            container.close()


def _pictures(folder: Path, begin: str) -> tuple[Path, ...]:
    found = (file for file in folder.glob(f"{begin}*") if file.suffix.lower() in PICTURES)
    return tuple(sorted(found))
