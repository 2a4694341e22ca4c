"""``gst:PIPELINE``: any pipeline of GStreamer 1.x that ends in raw video.

GStreamer is optional: ``./surg dev setup --gstreamer`` installs it. A buffer is stamped with the
time of the pipeline's clock at capture.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from surg_perception.capture.picture_source import Grabbed, PictureSource, SourceError, Wanted

SINK = (
    "videoconvert ! video/x-raw,format=RGB ! appsink name=surg sync=false max-buffers=2 drop=true"
)
START_S, SILENT_S = 10, 2
MESSAGE_MS = 200
"""A message may come a little later than its effect."""
ERRORS = (
    (
        "No such element",
        "no_library",
        "GStreamer lacks an element; install it with ./surg dev setup --gstreamer",
    ),
    ("no element", "no_library", "GStreamer lacks an element; ./surg dev setup --gstreamer"),
    ("Device or resource busy", "busy", "the device is busy; close the other program"),
    ("Permission denied", "no_permission", "no permission: join the group 'video'"),
    ("Could not open", "no_device", "the device or file cannot be opened; is it plugged in?"),
    ("No such file", "no_device", "there is no such device or file"),
    ("not-negotiated", "wrong_format", "the source does not have this size, rate or format"),
    ("could not link", "wrong_format", "the source does not have this size, rate or format"),
)
"""Words of GStreamer's messages, code, cure; the first that fits counts."""


def translated(where: str, text: str) -> SourceError:
    """A message of GStreamer with its cure."""
    for words, code, cure in ERRORS:
        if words.lower() in text.lower():
            return SourceError(code, f"{where}: {cure} (GStreamer: {text})")
    return SourceError("failed", f"{where}: GStreamer: {text}")


def gstreamer(where: str) -> Any:
    """The module Gst, ready.

    Raises:
        SourceError: ``no_library``: it is not installed.
    """
    try:
        import gi

        gi.require_version("Gst", "1.0")
        from gi.repository import Gst
    except (ImportError, ValueError) as error:
        raise SourceError(
            "no_library", f"{where}: GStreamer is not installed; ./surg dev setup --gstreamer"
        ) from error
    Gst.init(None)
    return Gst


class GstreamerSource(PictureSource):
    """One pipeline."""

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self._where = f"endoscope.source: gst:{address}"
        self._gst = gstreamer(self._where)
        try:
            self._pipeline = self._gst.parse_launch(f"{address} ! {SINK}")
        except Exception as error:  # GLib.Error is no class of its own before gi is there
            raise translated(self._where, str(getattr(error, "message", error))) from error
        self._sink = self._pipeline.get_by_name("surg")
        self._pipeline.set_state(self._gst.State.PLAYING)
        done, _, _ = self._pipeline.get_state(START_S * self._gst.SECOND)
        if done == self._gst.StateChangeReturn.FAILURE:
            why = self._error()
            self.close()
            raise why or SourceError("failed", f"{self._where}: the pipeline does not start")

    @classmethod
    def devices(cls, address: str) -> list[str]:
        """One pipeline; its text may hold a plus sign."""
        return [address]

    def _error(self) -> SourceError | None:
        kinds = self._gst.MessageType.ERROR | self._gst.MessageType.EOS
        bus = self._pipeline.get_bus()
        message = bus.timed_pop_filtered(MESSAGE_MS * self._gst.MSECOND, kinds)
        if message is None:
            return None
        if message.type == self._gst.MessageType.EOS:
            return SourceError("ended", f"{self._where}: the pipeline has ended")
        error, detail = message.parse_error()
        return translated(self._where, f"{error.message} {detail or ''}".strip())

    def pictures(self) -> Iterator[Grabbed]:
        """Every buffer of the pipeline."""
        while True:
            sample = self._sink.emit("try-pull-sample", SILENT_S * self._gst.SECOND)
            if sample is None:
                raise self._error() or SourceError(
                    "no_signal",
                    f"{self._where}: no picture for {SILENT_S} s: check cable and camera",
                )
            received = self.wanted.now()
            buffer, shape = sample.get_buffer(), sample.get_caps().get_structure(0)
            width, height = shape.get_value("width"), shape.get_value("height")
            good, mapped = buffer.map(self._gst.MapFlags.READ)
            if not good:
                continue
            try:
                stride = (3 * width + 3) // 4 * 4
                rows = np.frombuffer(mapped.data, np.uint8)[: height * stride]
                rows = rows.reshape(height, stride)[:, : 3 * width]
                picture = rows.reshape(height, width, 3).copy()
            finally:
                buffer.unmap(mapped)
            yield Grabbed(received - self._age(buffer), received, (picture,))

    def _age(self, buffer: Any) -> int:
        """Time since the buffer's capture by the pipeline's clock [ns]; 0: it has no time."""
        clock = self._pipeline.get_clock()
        if clock is None or buffer.pts == self._gst.CLOCK_TIME_NONE:
            return 0
        age = clock.get_time() - self._pipeline.get_base_time() - buffer.pts
        return max(0, int(age))

    def close(self) -> None:
        """Stop the pipeline."""
        self._pipeline.set_state(self._gst.State.NULL)
