"""Writes one camera of an episode: one video, or several parts.

A video has one size and increasing times. The next part, ``<camera>.2.mp4`` with its own sidecar,
begins when the camera changes its size or kind of pixels, its clock is set back or jumps far ahead,
or its encoder dies. Frames that the encoder had not taken go into the next part. A camera that
needs too many parts is no longer recorded, and its frames are counted as dropped.
"""

from __future__ import annotations

import functools
import threading
from pathlib import Path
from typing import Any

from surg_recording.video.image_frame import Frame
from surg_recording.video.video_encoder import ENCODINGS
from surg_recording.video.video_sink import VideoSink, unusable

MAX_PARTS = 8

MAX_GAP_NS = 600_000_000_000
"""A longer pause between two frames begins the next part: MP4 counts a frame's duration in 32 bits
of microseconds."""


class CameraSink:
    """Writes one camera. ``put`` is called by one thread, the rest by any."""

    def __init__(self, folder: Path, name: str, **options: Any) -> None:
        """Start the first encoder; options as for ``VideoSink``."""
        self.name = name
        self._start = functools.partial(VideoSink, folder, **options)
        self.changes: list[str] = []
        self._faults: list[str] = []
        self.repeated = 0
        """Frames with the same picture as the one before: frozen camera or still scene."""
        self._last_data: bytes | None = None
        self._given_up: str | None = None
        self._turning = threading.Lock()
        self._empty_before = False
        self.newest = (0, 0)
        """Newest stamp and its distance to the one before [ns]; 0: unknown."""
        self._clock_back = False
        self._number = 0
        self._parts = [self._make(0)]

    @property
    def part(self) -> VideoSink:
        """The video that is being written."""
        return self._parts[-1]

    @property
    def received(self) -> int:
        """Frames received."""
        return sum(part.received for part in self._parts)

    @property
    def frames(self) -> int:
        """Frames written."""
        return sum(part.frames for part in self._parts)

    @property
    def dropped(self) -> int:
        """Frames not written."""
        return sum(part.dropped for part in self._parts)

    @property
    def error(self) -> str | None:
        """Why this video is incomplete; None if it is fine."""
        faults = [*self._faults, *([self._given_up] if self._given_up else [])]
        if self.part.error is not None and not self._given_up:
            faults.append(self.part.error)
        return "; ".join(faults) or None

    @property
    def last_skip(self) -> str | None:
        """Why the newest skipped frame could not be encoded."""
        return next((part.last_skip for part in reversed(self._parts) if part.last_skip), None)

    def describe(self) -> dict[str, Any]:
        """The manifest's entry of the camera's stream."""
        return {
            "size": self._parts[0].size,
            "encoding": self._parts[0].encoding,
            "quality": self._parts[0].quality,
            "last_skip": self.last_skip,
            "repeated": self.repeated,
            "parts": len([part for part in self._parts if part.frames]),
            "changes": list(self.changes),
        }

    def expect_earlier_stamps(self) -> None:
        """The clock was set back: the first frame stamped before the newest begins a new part."""
        self._clock_back = True

    def put(self, frame: Frame) -> bool:
        """Queue one image; False if it was dropped. Blocks in lock-step only."""
        last, _ = self.newest
        discontinuity = self._discontinuity(frame, last)
        if discontinuity is not None:
            self._clock_back, self.newest, last = False, (0, 0), 0
            if self.part.error is not None:
                self._next_part(f"the encoder failed ({self.part.error})")
            self._next_part(discontinuity, a_fault=False)
        if frame.stamp_ns > last:
            self.newest = frame.stamp_ns, frame.stamp_ns - last if last else 0
        if frame.data == self._last_data:
            self.repeated += 1
        self._last_data = frame.data
        size = self.part.size
        if self.part.error is not None:
            self._next_part(f"the encoder failed ({self.part.error})")
        elif size and unusable(frame) is None:
            if size != f"{frame.width}x{frame.height}":
                self._next_part(f"its size changed from {size} to {frame.width}x{frame.height}")
            elif _codec(frame.encoding) != _codec(self.part.encoding):
                change = f"from {self.part.encoding} to {frame.encoding}"
                self._next_part(f"its encoding changed {change}")
        return self.part.put(frame)

    def _discontinuity(self, frame: Frame, last: int) -> str | None:
        """Why a frame cannot follow the one stamped ``last`` [ns] in one video; None: it can."""
        if not last or unusable(frame) is not None:
            return None
        if self._clock_back and frame.stamp_ns <= last:
            return "the clock was set back"
        if frame.stamp_ns > last + MAX_GAP_NS:
            return f"its stamps jumped ahead by {(frame.stamp_ns - last) * 1e-9:.0f} s"
        return None

    def close(self, timeout_s: float = 60.0) -> None:
        """Write the backlog and finish the files. May be called twice."""
        if self.part.error is not None and self.part.backlog:
            self._next_part(f"the encoder failed ({self.part.error})")
        for part in self._parts:
            part.close(timeout_s)

    def _next_part(self, why: str, a_fault: bool = True) -> None:
        """Begin another part, unless that is pointless."""
        with self._turning:
            old = self.part
            if self._given_up is not None:
                return
            if old.error is not None and not old.frames and self._empty_before:
                self._given_up = f"{why}, twice before its first frame"
                return
            self._empty_before = not old.frames
            if len(self._parts) >= MAX_PARTS:
                # The encoder goes on with frames of its size; it skips and counts the others.
                self._given_up = f"{why}; {MAX_PARTS} parts are enough"
                return
            left: list[Frame] = []
            missed = 0
            if old.error is not None:
                left, missed = old.abandon()
                if not old.frames:  # nothing is in it: the camera's first video is never missing
                    old.path.unlink(missing_ok=True)
                    old.sidecar.unlink(missing_ok=True)
                    self._number -= 1
            else:
                threading.Thread(target=old.close, name=f"end_{old.name}", daemon=True).start()
            try:
                new = self._make(missed)
            except OSError as problem:
                self._given_up = f"{why}; no further encoder ({problem.strerror})"
                return
            self.changes.append(f"{why}: goes on in {new.name}")
            if a_fault:
                self._faults.append(self.changes[-1])
            self._parts = [*self._parts, new]
        for frame in left:
            new.put(frame)

    def _make(self, missed: int) -> VideoSink:
        self._number += 1
        suffix = "" if self._number == 1 else f".{self._number}"
        return self._start(f"{self.name}{suffix}", missed=missed)


def _codec(encoding: str) -> str:
    """The codec of a ROS image encoding."""
    return ENCODINGS[encoding].codec
