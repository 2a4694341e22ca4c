"""The process of one device: opens it, judges and divides its pictures, writes them to a pipe.

A driver that hangs or crashes takes this process along and nothing else. It opens a device that has
gone again, once a second, by its persistent name. Argument: the `CaptureSettings` as JSON.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from surg_perception.capture import eye_layout, frame_pipe
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.frame_pipe import DeviceState, Pictures
from surg_perception.capture.picture_source import (
    Grabbed,
    PictureSource,
    SourceError,
    SourceUri,
    Wanted,
)
from surg_perception.capture.signal_watch import CURES, Signal, SignalWatch

REOPEN_S = 1.0


class EyeSplitter:
    """From what a source grabs to the eyes, or the reason why there are none."""

    def __init__(self, settings: CaptureSettings, live: bool) -> None:
        self._settings, self._latency_ns = settings, round(1e9 * settings.latency)
        rows = settings.layout == "rows"
        self._watches = [SignalWatch(settings.size, not live, rows) for _ in range(2)]

    def take(self, grabbed: Grabbed) -> Pictures | DeviceState:
        """The eyes with one stamp; a state where a picture does not show a live endoscope."""
        settings = self._settings
        stamp = grabbed.stamp_ns
        for watch, picture in zip(self._watches, grabbed.pictures, strict=False):
            signal = watch.judge(picture, stamp)
            if signal is not Signal.LIVE:
                return DeviceState(signal.value, self._why(signal, picture))
        try:
            eyes = self._eyes(grabbed.pictures)
        except eye_layout.LayoutError as error:
            return DeviceState("wrong_format", f"endoscope.layout: {error}")
        if len(eyes) != settings.eyes:
            return DeviceState(
                "wrong_format",
                f"endoscope.layout: {settings.layout}: {settings.source} delivers {len(eyes)} "
                f"picture(s) at a time, {settings.eyes} are needed: two needs a device or file for "
                "each eye, such as v4l2:/dev/video0+/dev/video2",
            )
        jpegs = grabbed.jpegs if len(grabbed.jpegs) == len(eyes) and self._untouched else ()
        return Pictures(stamp - self._latency_ns, grabbed.received_ns, eyes, jpegs)

    @property
    def _untouched(self) -> bool:
        """Whether a grabbed picture is an eye's as it is."""
        return self._settings.flip == "none" and self._settings.layout in ("two", "mono")

    def _eyes(self, pictures: tuple[eye_layout.Image, ...]) -> tuple[eye_layout.Image, ...]:
        settings = self._settings
        if len(pictures) > 1:
            eyes = tuple(eye_layout.turned(picture, settings.flip) for picture in pictures)
            eyes = eyes[::-1] if settings.swap else eyes
        else:
            eyes = eye_layout.split(pictures[0], settings.layout, settings.swap, settings.flip)
        most = (settings.publish_width, settings.publish_height)
        return tuple(eye_layout.fitted(eye, most) for eye in eyes)

    def _why(self, signal: Signal, picture: eye_layout.Image) -> str:
        text = CURES[signal]
        if signal is Signal.WRONG_SIZE:
            height, width = picture.shape[:2]
            text = f"{text}: {width} x {height}, not {' x '.join(map(str, self._settings.size))}"
        return f"endoscope.source: {self._settings.source}: {text}"


def messages(settings: CaptureSettings, wanted: Wanted) -> Iterator[Pictures | DeviceState]:
    """What a device delivers, without end; a state only when it changes.

    The iterator ends with the recording where the source is one.
    """
    uri, said = SourceUri.parse(settings.source), ""
    reopen = uri
    while True:
        source: PictureSource | None = None
        try:
            source = reopen.open(wanted)
            reopen = SourceUri(uri.kind, source.reopen, uri.options)
            divider = EyeSplitter(settings, source.live)
            for grabbed in source.pictures():
                message = divider.take(grabbed)
                code = message.code if isinstance(message, DeviceState) else frame_pipe.OPEN
                if code != said:
                    said = code
                    yield (
                        message
                        if isinstance(message, DeviceState)
                        else DeviceState(frame_pipe.OPEN, f"{reopen}: pictures")
                    )
                if isinstance(message, Pictures):
                    yield message
        except SourceError as error:
            if error.code != said:
                said = error.code
                yield DeviceState(error.code, str(error))
            if source is not None and not source.live and error.code == "ended":
                return
        finally:
            if source is not None:
                source.close()
        wanted.sleep(REOPEN_S)


def run(settings: CaptureSettings, out: BinaryIO) -> None:
    """Write the messages of a device to a pipe until the recording ends."""
    coded = settings.layout in ("two", "mono")
    folder = Path(settings.cell or ".")
    wanted = Wanted(time.time_ns, time.sleep, settings.size, settings.rate, folder, coded=coded)
    for message in messages(settings, wanted):
        frame_pipe.write(out, message)


def _end_with_parent() -> None:
    """Thread: the parent holds the other end of standard input and writes nothing."""
    sys.stdin.buffer.read()
    os._exit(0)


def main() -> int:
    """Run the process; returns the exit code."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print does not go into the pipe
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    try:
        run(CaptureSettings(**json.loads(sys.argv[1])), out)
    except (BrokenPipeError, KeyboardInterrupt):
        return 0
    threading.Event().wait()  # the recording has ended: silence, until the parent ends
    return 0


if __name__ == "__main__":
    sys.exit(main())
