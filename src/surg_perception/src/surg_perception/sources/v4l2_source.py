"""``v4l2:/dev/video0``: a grabber or camera of Video4Linux, stamped by its driver.

Most drivers stamp by the system's monotonic clock, some by the wall clock; a picture of any other
is stamped on arrival. FFmpeg hands on what the driver says (``timestamps=default``). Its own
conversion (``abs``) filters: on the kernel's vivid at 5 pictures per second the stamps lay 0.18 s
in the future.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import av

from surg_perception.capture.picture_source import (
    Grabbed,
    PictureSource,
    SourceError,
    Wanted,
)
from surg_perception.sources import av_input
from surg_recording.video.colours import Colours

PERSISTENT = ("by-id", "by-path")
"""Folders of names that stay with a device, the best first."""
RATE_TOLERANCE = 0.02
OLDEST_NS = 10_000_000_000
"""A picture that has just been read is younger by the clock that stamped it."""


def persistent_name(device: str, folder: Path = Path("/dev/v4l")) -> str:
    """The name by which udev lists this device whatever its number; itself without one.

    Args:
        device: Such as ``/dev/video0``.
        folder: Of udev's links.
    """
    here = os.path.realpath(device)
    for kind in PERSISTENT:
        for link in sorted((folder / kind).glob("*")):
            if os.path.realpath(link) == here:
                return str(link)
    return device


class V4l2Source(PictureSource):
    """One Video4Linux device.

    Options: ``format`` (``mjpeg``, ``yuyv422``, ...: FFmpeg's name of the coded or pixel format).
    """

    keys = ("format",)

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self._where = f"endoscope.source: v4l2:{address}"
        self._reopen = persistent_name(address)
        self._container = self._open()
        self._first = self._next()
        self._clock = self._clock_of(self._first)
        self._check()

    @property
    def reopen(self) -> str:
        """The persistent name."""
        return self._reopen

    def _open(self) -> Any:
        asked = {"timestamps": "default"}
        if self.wanted.size != (0, 0):
            asked["video_size"] = "{}x{}".format(*self.wanted.size)
        if self.wanted.rate:
            asked["framerate"] = f"{self.wanted.rate:g}"
        if "format" in self.options:
            asked["input_format"] = self.options["format"]
        container = av_input.open_input(
            self._where, self.address, format="v4l2", options=asked, timeout=(5.0, 5.0)
        )
        av_input.decode_at_once(container)
        self._packets = container.demux(container.streams.video[0])
        return container

    def _next(self) -> Any:
        try:
            packet = next(self._packets)
        except StopIteration:
            raise self._gone() from None
        except (OSError, av.error.FFmpegError) as error:
            if getattr(error, "errno", 0) in (errno.ENODEV, errno.EIO, errno.EPIPE):
                raise self._gone() from error
            raise av_input.refusal(self._where, error) from error
        if packet.pts is None:
            raise self._gone()
        return packet

    def _clock_of(self, packet: Any) -> Callable[[], int] | None:
        """The clock by which the driver stamps; None: an unknown one."""
        for clock in (self.wanted.monotonic, self.wanted.now):
            if 0 <= clock() - _nanoseconds(packet) < OLDEST_NS:
                return clock
        return None

    def _stamp(self, packet: Any, received: int) -> int:
        """The driver's stamp in ROS time; where its clock is unknown, the arrival [ns]."""
        if self._clock is None:
            return received
        return received - max(0, self._clock() - _nanoseconds(packet))

    def _gone(self) -> SourceError:
        return SourceError(
            "gone",
            f"{self._where}: the device has gone; plug it in again. It is opened again by its "
            f"persistent name, {self._reopen}",
        )

    def _check(self) -> None:
        """Drivers take the nearest size and rate that they have, without an error."""
        stream = self._container.streams.video[0]
        size, rate = (stream.width, stream.height), float(stream.average_rate or 0)
        asked, per_second = self.wanted.size, self.wanted.rate
        if asked != (0, 0) and size != asked:
            raise self._other("size", "{} x {}".format(*asked), "{} x {}".format(*size))
        if per_second and rate and abs(rate - per_second) > RATE_TOLERANCE * per_second:
            raise self._other("rate", f"{per_second:g}/s", f"{rate:g}/s")
        if "format" in self.options:
            codec = stream.codec_context
            found = {codec.name, str(codec.pix_fmt)}
            if self.options["format"] not in found:
                given = " or ".join(sorted(found))
                raise self._other("source (option format)", self.options["format"], given)

    def _other(self, key: str, asked: str, given: str) -> SourceError:
        self.close()
        return SourceError(
            "wrong_format",
            f"{self._where}: endoscope.{key}: {asked} is asked for, the device gives {given}; "
            f"v4l2-ctl -d {self.address} --list-formats-ext lists what it has",
        )

    def pictures(self) -> Iterator[Grabbed]:
        """Every picture of the driver, decoded."""
        packet: Any = self._first
        colours = Colours()
        while True:
            received = self.wanted.now()
            stamp = self._stamp(packet, received)
            coded = self.wanted.coded and packet.stream.codec_context.name == "mjpeg"
            jpegs = (bytes(packet),) if coded else ()
            try:
                frames = packet.decode()
            except av.error.FFmpegError:
                frames = []  # a truncated picture; the next one is whole
            for frame in frames:
                yield Grabbed(stamp, received, (colours(frame),), jpegs)
            packet = self._next()

    def close(self) -> None:
        """Give the device back."""
        self._container.close()


def _nanoseconds(packet: Any) -> int:
    return round(packet.pts * packet.time_base * 1_000_000_000)
