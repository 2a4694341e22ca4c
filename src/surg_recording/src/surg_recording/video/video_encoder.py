"""The encoder of one camera: a process that reads frames from standard input.

Started by ``video_sink.VideoSink``; needs PyAV and numpy, and OpenCV for compressed pictures. The
files are created with the first frame. It ends when its input ends, also when the recorder was
killed, and then leaves a finished file. It answers on standard output, one line each: ``ready`` at
the start, ``frame N``, ``skip REASON`` for a frame it could not take, ``error REASON`` before it
gives up, ``end`` after a clean finish.

Input: per frame ``HEADER`` and then the image as in the message: rows, or JPEG or PNG.
"""

from __future__ import annotations

import contextlib
import fractions
import os
import signal
import struct
import sys
from typing import BinaryIO

import av
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]

HEADER = struct.Struct("<qqqIIIIQ")
"""stamp_ns, receive_ns, frames dropped before this one, width, height, bytes per row, encoding
(index into ``ENCODINGS``), number of bytes that follow."""

ENCODINGS: dict[str, tuple[str, int]] = {
    "rgb8": ("rgb24", 3),
    "bgr8": ("bgr24", 3),
    "mono8": ("gray", 1),
    "8UC3": ("bgr24", 3),
    "8UC1": ("gray", 1),
    "rgba8": ("rgba", 4),
    "bgra8": ("bgra", 4),
    "yuv422_yuy2": ("yuyv422", 2),
    "jpeg": ("bgr24", 0),
    "png": ("bgr24", 0),
}
"""ROS image encoding → PyAV pixel format and bytes per pixel; 0: a compressed picture."""

_FORMATS = list(ENCODINGS.values())

MICROSECONDS = fractions.Fraction(1, 1_000_000)

CONTAINER_OPTIONS = {
    # A fragment every 0.2 s, handed to the kernel at once: what a kill -9 can lose.
    "movflags": "empty_moov+default_base_moof",
    "frag_duration": "200000",
    "flush_packets": "1",
    "video_track_timescale": "1000000",
}


class Encoder:
    """One MP4 file (H.264, variable frame rate, microseconds) and its sidecar CSV."""

    def __init__(self, path: str, sidecar: str, preset: str) -> None:
        self._path, self._sidecar_path = path, sidecar
        self._container: av.container.OutputContainer | None = None
        self._sidecar = -1
        self._options = {
            "preset": preset,
            "crf": "23",
            "tune": "zerolatency",  # no look-ahead: a frame that went in comes out at once
            "bf": "0",
        }
        self._stream: av.video.stream.VideoStream | None = None
        self._first_stamp = 0
        self._last_pts = -1
        self._size = (0, 0)
        self._missing = 0
        self.frames = 0

    def add(
        self, image: Image, pixels: str, stamp_ns: int, receive_ns: int, dropped: int
    ) -> str | None:
        """Encode one image; returns why it was skipped, or None.

        ``dropped`` counts the frames lost before this one; the sidecar adds those skipped here.
        """
        self._missing += dropped
        height, width = image.shape[:2]
        if self._stream is None:
            self._open(width, height, stamp_ns)
        if (width, height) != self._size:
            self._missing += 1
            before = "x".join(map(str, self._size))
            return f"the camera changed its size from {before} to {width}x{height}"
        pts = (stamp_ns - self._first_stamp) // 1000
        if pts <= self._last_pts:
            self._missing += 1
            return f"stamp {stamp_ns} is not later than the frame before"
        self._last_pts = pts
        # H.264 4:2:0 has even sizes: an odd last row or column is cut off.
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(image[: height & ~1, : width & ~1]), format=pixels
        )
        frame.pts = pts
        frame.time_base = MICROSECONDS
        assert self._stream is not None and self._container is not None
        packets = self._stream.encode(frame)
        os.write(
            self._sidecar, f"{self.frames},{stamp_ns},{receive_ns},{pts},{self._missing}\n".encode()
        )
        self.frames += 1
        self._missing = 0
        self._container.mux(packets)
        return None

    def miss(self, dropped: int) -> None:
        """Count an image that could not be decoded, and those lost before it."""
        self._missing += dropped + 1

    def close(self) -> None:
        """Flush the encoder and finish the files."""
        if self._container is None:
            return
        try:
            if self._stream is not None:
                self._container.mux(self._stream.encode())
        finally:
            self._container.close()
            os.fsync(self._sidecar)
            os.close(self._sidecar)

    def _open(self, width: int, height: int, stamp_ns: int) -> None:
        """Create the files for the first image."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._sidecar = os.open(self._sidecar_path, flags, 0o644)
        os.write(self._sidecar, b"frame,stamp_ns,receive_ns,pts,dropped\n")
        self._container = av.open(self._path, "w", format="mp4", options=CONTAINER_OPTIONS)
        stream = self._container.add_stream("libx264", rate=60, options=self._options)
        stream.width, stream.height = width & ~1, height & ~1
        stream.pix_fmt = "yuv420p"
        stream.time_base = MICROSECONDS
        stream.codec_context.time_base = MICROSECONDS
        stream.codec_context.gop_size = 20
        stream.codec_context.thread_count = 1
        self._stream, self._size, self._first_stamp = stream, (width, height), stamp_ns


def _read_exactly(source: BinaryIO, count: int) -> bytes | None:
    data = source.read(count)
    return data if data is not None and len(data) == count else None


def _say(text: str) -> None:
    # When the recorder is gone nobody listens: the file is finished all the same.
    with contextlib.suppress(OSError):
        os.write(1, (text.replace("\n", " ") + "\n").encode())


def run(source: BinaryIO, encoder: Encoder) -> None:
    """Encode frames from ``source`` until it ends."""
    while True:
        head = _read_exactly(source, HEADER.size)
        if head is None:
            return
        stamp, received, dropped, width, height, step, code, size = HEADER.unpack(head)
        data = _read_exactly(source, size)
        if data is None:
            return
        pixels, channels = _FORMATS[code]
        try:
            image = rows_of(data, width, height, step, channels) if channels else decoded(data)
            if image.shape[:2] != (height, width):
                raise ValueError(f"{image.shape[1]}x{image.shape[0]} pixels came out")
        except ValueError as problem:
            encoder.miss(dropped)
            _say(f"skip a compressed picture of {width}x{height} pixels: {problem}")
            continue
        skipped = encoder.add(image, pixels, stamp, received, dropped)
        _say(f"skip {skipped}" if skipped else f"frame {encoder.frames}")


def rows_of(data: bytes, width: int, height: int, step: int, channels: int) -> Image:
    """A raw image, (height, width) or (height, width, channels), of rows of ``step`` bytes."""
    image = np.frombuffer(data, np.uint8).reshape(height, step)[:, : width * channels]
    return image.reshape(height, width, channels) if channels > 1 else image


def decoded(data: bytes) -> Image:
    """A compressed picture, (height, width, 3) BGR, not rotated by its tags; or a ValueError."""
    try:
        import cv2
    except ImportError:
        raise ValueError("OpenCV is not installed (apt: python3-opencv)") from None
    cv2.setNumThreads(1)
    try:
        image = cv2.imdecode(
            np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error as problem:
        raise ValueError(f"it cannot be decoded ({problem.err})") from None
    if image is None:
        raise ValueError("it cannot be decoded")
    return np.asarray(image)


def main(arguments: list[str]) -> int:
    """``video_encoder.py VIDEO SIDECAR PRESET``; returns the exit code."""
    # Ctrl-C reaches the whole terminal group: the end of the input is the only stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.nice(5)  # frames can wait in the queue, control cycles cannot wait
    av.logging.set_level(av.logging.FATAL)
    try:
        encoder = Encoder(*arguments)
        _say("ready")
        try:
            run(sys.stdin.buffer, encoder)
        finally:
            encoder.close()
    except Exception as problem:  # whatever it is: one line for the recorder instead of a trace
        _say(f"error {type(problem).__name__}: {problem}")
        return 1
    _say("end")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
