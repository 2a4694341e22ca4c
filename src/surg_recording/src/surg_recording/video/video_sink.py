"""Writes one video: a queue in front of an encoder process.

``camera_sink.CameraSink`` creates one per part of a camera's video. In free-run ``put`` never
blocks: a full queue drops the frame and counts it. In lock-step it waits for room, so that camera
and simulator wait too and no frame is lost.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path

from surg_core.host.niceness import give_way
from surg_recording.file_io import write_all
from surg_recording.video import video_encoder, video_file
from surg_recording.video.image_frame import Frame

QUEUE_LIMIT = 40
"""Frames that may wait for the encoder: 2 s at 20 fps."""

STALL_S = 10.0
"""Time without a frame taken after which an encoder has failed [s]."""

IN_FLIGHT = 16
"""Frames that the encoder may hold without an answer."""

GIVES_WAY = 5
"""Niceness of an encoder: frames can wait in the queue, cycles and a person's hand cannot."""

_LARGE_PIPE = 1 << 20


class VideoSink:
    """Writes one video to ``<folder>/<name>.mp4`` and ``<folder>/<name>.csv``."""

    def __init__(
        self,
        folder: Path,
        name: str,
        *,
        block: bool,
        preset: str = "ultrafast",
        quality: str = str(video_encoder.CRF),
        queue_limit: int = QUEUE_LIMIT,
        keep_open: tuple[int, ...] = (),
        missed: int = 0,
    ) -> None:
        """Start the encoder process.

        Args:
            folder: Folder of the files.
            name: Camera; both files are named after it.
            block: Wait for room instead of dropping (lock-step).
            preset: x264: ``ultrafast`` (13 ms per 2×720p pair) or ``veryfast`` (23 ms, smaller).
            quality: x264's crf, or ``lossless``.
            queue_limit: Frames that may wait.
            keep_open: File descriptors that the encoder inherits (the episode's lock).
            missed: Frames of the camera that were lost before the first of this video.
        """
        self.path, self.sidecar = folder / f"{name}.mp4", folder / f"{name}.csv"
        self.name = name
        self.quality = quality
        self.received = 0
        self.dropped = 0
        """Frames not written: queue full, unusable, or after a failure."""
        self.frames = 0
        self.error: str | None = None
        self.last_skip: str | None = None
        self.encoding = self.size = ""
        self._block, self._limit = block, queue_limit
        self._queue: deque[tuple[bytes, Frame]] = deque()
        self._in_flight: deque[Frame] = deque()
        self._room = threading.Condition()
        self._ending = self._counted = False
        self._ready = threading.Event()
        self._dropped_since = missed
        self._process = self._start_encoder(preset, quality, keep_open)
        self._feeder = threading.Thread(target=self._feed, name=f"video_{name}", daemon=True)
        self._listener = threading.Thread(target=self._listen, name=f"answers_{name}", daemon=True)
        self._feeder.start()
        self._listener.start()

    def _start_encoder(
        self, preset: str, quality: str, keep_open: tuple[int, ...]
    ) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, video_encoder.__file__, self.path, self.sidecar, preset, quality],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=keep_open,
            start_new_session=True,
            bufsize=0,
        )
        give_way(GIVES_WAY, process.pid)
        assert process.stdin is not None
        with contextlib.suppress(OSError):  # a small pipe is only slower
            fcntl.fcntl(process.stdin, fcntl.F_SETPIPE_SZ, _LARGE_PIPE)
        return process

    def wait_ready(self, timeout_s: float) -> bool:
        """Wait until the encoder takes frames; until then they stay in memory."""
        return self._ready.wait(timeout_s)

    @property
    def pid(self) -> int:
        """Process id of the encoder."""
        return self._process.pid

    @property
    def backlog(self) -> int:
        """Frames received and neither written nor dropped yet."""
        return self.received - self.frames - self.dropped

    def put(self, frame: Frame) -> bool:
        """Queue one image; False if it was dropped."""
        problem = unusable(frame)
        with self._room:
            self.received += 1
            if problem is not None:
                self.last_skip = problem
                return self._drop()
            deadline = time.monotonic() + STALL_S
            while self._block and len(self._queue) >= self._limit and not self._over():
                if not self._room.wait(max(0.0, deadline - time.monotonic())):
                    self.error = f"the encoder took no frame for {STALL_S:g} s"
            # After a failure frames are still taken: they go into the next part (``abandon``).
            if self._ending or len(self._queue) >= self._limit:
                return self._drop()
            head = video_encoder.HEADER.pack(
                *(frame.stamp_ns, frame.receive_ns, self._dropped_since),
                *(frame.width, frame.height, frame.step),
                *(list(video_encoder.ENCODINGS).index(frame.encoding), len(frame.data)),
            )
            self._dropped_since = 0
            self.encoding, self.size = frame.encoding, f"{frame.width}x{frame.height}"
            self._queue.append((head, frame))
            self._room.notify_all()
            return True

    def abandon(self) -> tuple[list[Frame], int]:
        """Stop at once; returns the frames that are not in the file, and how many are lost.

        Lost are those dropped since the last one, and those of a truncated fragment.
        """
        with self._room:
            self._ending = True
            self.error = self.error or "abandoned"
            self._room.notify_all()
        self._process.kill()
        self._process.wait()
        self._feeder.join()
        self._listener.join()
        self._counted = True
        before = self.dropped
        newest = self._count_what_is_there()
        with self._room:
            waiting = [*self._in_flight, *(frame for _, frame in self._queue)]
            left = [frame for frame in waiting if frame.stamp_ns > newest]
            self._queue.clear()
            self._in_flight.clear()
            self.received -= len(left)
            self.dropped = self.received - self.frames
            return left, max(0, self.dropped - before) + self._dropped_since

    def _count_what_is_there(self) -> int:
        """Repair the files of an encoder that failed; returns the newest stamp in them [ns]."""
        if not self.path.exists():
            self.frames = 0
            return -1
        self.frames = video_file.mend(self.path, self.sidecar)
        return video_file.last_stamp(self.sidecar)

    def close(self, timeout_s: float = 60.0) -> None:
        """Write the backlog and finish the file, within ``timeout_s``. May be called twice."""
        with self._room:
            self._ending = True
            self._room.notify_all()
        deadline = time.monotonic() + timeout_s
        self._feeder.join(timeout_s)
        try:
            self._process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            self.error = self.error or f"the encoder did not finish within {timeout_s:g} s"
            self._process.kill()
            self._process.wait()
        self._listener.join(5.0)
        if self._process.returncode != 0 and self.error is None:
            self.error = f"the encoder ended with code {self._process.returncode}"
        if self.error is not None and not self._counted:
            self._counted = True
            with contextlib.suppress(OSError):
                self._count_what_is_there()
        with self._room:  # what never came out
            self.dropped = max(self.dropped, self.received - self.frames)

    def _over(self) -> bool:
        return self.error is not None or self._ending

    def _drop(self) -> bool:
        self.dropped += 1
        self._dropped_since += 1
        return False

    def _feed(self) -> None:
        """Thread: queue → pipe."""
        pipe = self._process.stdin
        assert pipe is not None
        try:
            while True:
                with self._room:
                    while self.error is None and not (
                        self._queue and len(self._in_flight) < IN_FLIGHT
                    ):
                        if self._ending and not self._queue:
                            break
                        self._room.wait()
                    if self.error is not None or not self._queue:
                        break
                    head, frame = self._queue.popleft()
                    self._in_flight.append(frame)
                    self._room.notify_all()
                write_all(pipe.fileno(), head)
                write_all(pipe.fileno(), frame.data)
        except OSError as problem:
            with self._room:
                self.error = self.error or f"the encoder is gone ({problem.strerror})"
        finally:
            with self._room:
                self._room.notify_all()
            with contextlib.suppress(OSError):
                pipe.close()

    def _listen(self) -> None:
        """Thread: the encoder's answers."""
        answers = self._process.stdout
        assert answers is not None
        ended = False
        with os.fdopen(os.dup(answers.fileno()), encoding="utf-8", errors="replace") as lines:
            for line in lines:
                word, _, rest = line.rstrip("\n").partition(" ")
                with self._room:
                    if word == "ready":
                        self._ready.set()
                    elif word == "frame":
                        self.frames = int(rest)
                        self._in_flight.popleft()
                    elif word == "skip":
                        self.last_skip = rest
                        self.dropped += 1
                        self._in_flight.popleft()
                    elif word == "error":
                        self.error = rest
                    elif word == "end":
                        ended = True
                    self._room.notify_all()
        self._ready.set()  # no later line will set it
        with self._room:
            if not ended and self.error is None:
                self.error = "the encoder was killed or ended early"
            self._room.notify_all()
        answers.close()


def unusable(frame: Frame) -> str | None:
    """Why an image cannot be encoded, or None."""
    if frame.problem is not None:
        return frame.problem
    if frame.encoding not in video_encoder.ENCODINGS:
        return f"encoding {frame.encoding!r}; allowed: {', '.join(video_encoder.ENCODINGS)}"
    width, height, step, size = frame.width, frame.height, frame.step, len(frame.data)
    channels = video_encoder.ENCODINGS[frame.encoding].size
    if not channels and min(width, height) >= 2:
        return None
    if width < 2 or height < 2 or step < width * channels or size != step * height:
        return (
            f"image of {width}x{height} pixels, {step} bytes per row and {size} bytes"
            " does not add up"
        )
    return None
