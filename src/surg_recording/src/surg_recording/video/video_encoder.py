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
from typing import BinaryIO, NamedTuple

import av
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Values = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

HEADER = struct.Struct("<qqqIIIIQ")
"""stamp_ns, receive_ns, frames dropped before this one, width, height, bytes per row, encoding
(index into ``ENCODINGS``), number of bytes that follow."""

CRF = 23
"""Quality of a recording, if nothing else is asked for."""

CRF_RATE = 25
"""[1/s] What x264 is told. Its crf spends less on pictures that it believes to be short, and
without look-ahead it believes this rate. At 25 a crf is what its name says."""

LOSSLESS = "lossless"
"""Quality at which every pixel comes back as it was; the others are x264's crf, 0 to 51."""


class Pixels(NamedTuple):
    """How the pixels of a ROS image encoding are written."""

    format: str
    """PyAV pixel format of the frames given to the encoder."""
    size: int
    """Bytes per pixel; 0: a compressed picture."""
    codec: str = "h264"
    """``png``: measured values, such as depth, which are always kept bit for bit."""


ENCODINGS: dict[str, Pixels] = {
    "rgb8": Pixels("rgb24", 3),
    "bgr8": Pixels("bgr24", 3),
    "mono8": Pixels("gray", 1),
    "8UC3": Pixels("bgr24", 3),
    "8UC1": Pixels("gray", 1),
    "rgba8": Pixels("rgba", 4),
    "bgra8": Pixels("bgra", 4),
    "yuv422_yuy2": Pixels("yuyv422", 2),
    "jpeg": Pixels("bgr24", 0),
    "png": Pixels("bgr24", 0),
    "mono16": Pixels("gray16le", 2, "png"),
    "16UC1": Pixels("gray16le", 2, "png"),
    "32FC1": Pixels("rgba", 4, "png"),  # the four bytes of a number, little-endian
}
"""ROS image encoding → how it is written. Values of several bytes are little-endian here."""

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
    """One MP4 file (variable frame rate, microseconds) and its sidecar CSV.

    H.264, in 4:2:0 or without loss; measured values are PNG pictures in the same container, because
    FFmpeg writes no FFV1 into MP4 and only fragmented MP4 survives a killed recorder.
    """

    def __init__(self, path: str, sidecar: str, preset: str, quality: str) -> None:
        self._path, self._sidecar_path = path, sidecar
        self._container: av.container.OutputContainer | None = None
        self._sidecar = -1
        self._preset, self._quality = preset, quality
        self._pixels = ""
        self._stream: av.video.stream.VideoStream | None = None
        self._first_stamp = 0
        self._last_pts = -1
        self._size = (0, 0)
        self._missing = 0
        self.frames = 0

    def add(
        self, image: Image, pixels: Pixels, stamp_ns: int, receive_ns: int, dropped: int
    ) -> str | None:
        """Encode one image; returns why it was skipped, or None.

        ``dropped`` counts the frames lost before this one; the sidecar adds those skipped here.
        """
        self._missing += dropped
        height, width = image.shape[:2]
        if self._stream is None:
            self._open(width, height, pixels, stamp_ns)
        if pixels.codec != self._pixels:
            self._missing += 1
            return f"the camera changed from {self._pixels} to {pixels.codec}"
        if (width, height) != self._size:
            self._missing += 1
            before = "x".join(map(str, self._size))
            return f"the camera changed its size from {before} to {width}x{height}"
        pts = (stamp_ns - self._first_stamp) // 1000
        if pts <= self._last_pts:
            self._missing += 1
            return f"stamp {stamp_ns} is not later than the frame before"
        self._last_pts = pts
        assert self._stream is not None and self._container is not None
        values, layout = self._values(image, pixels)
        cut = values[: self._stream.height, : self._stream.width]
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(cut), format=layout)
        if layout == "bgr24":  # FFmpeg turns it into video by a short cut, four levels off
            frame = frame.reformat(format="rgb24")
        frame.pts = pts
        frame.time_base = MICROSECONDS
        packets = self._stream.encode(frame)
        os.write(
            self._sidecar, f"{self.frames},{stamp_ns},{receive_ns},{pts},{self._missing}\n".encode()
        )
        self.frames += 1
        self._missing = 0
        self._container.mux(packets)
        return None

    def _values(self, image: Image, pixels: Pixels) -> tuple[Values, str]:
        """An image as the encoder takes it, and its PyAV pixel format."""
        if pixels.format == "gray16le":
            return image.reshape(*image.shape[:2], 2).view("<u2")[..., 0], "gray16le"
        if self._quality == LOSSLESS and pixels.format == "gray":
            # FFmpeg would stretch grey to the levels of video, and back with rounding.
            return np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2), "rgb24"
        return image, pixels.format

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

    def _open(self, width: int, height: int, pixels: Pixels, stamp_ns: int) -> None:
        """Create the files for the first image."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._sidecar = os.open(self._sidecar_path, flags, 0o644)
        os.write(self._sidecar, b"frame,stamp_ns,receive_ns,pts,dropped\n")
        self._container = av.open(self._path, "w", format="mp4", options=CONTAINER_OPTIONS)
        name, layout, options = _codec(pixels, self._preset, self._quality)
        stream = self._container.add_stream(name, rate=CRF_RATE, options=options)
        stream.pix_fmt = layout
        # 4:2:0 and 4:2:2 have even sizes: an odd last row or column is cut off.
        last = 1 if layout.startswith("yuv") else 0
        stream.width, stream.height = width - (width & last), height - (height & last)
        stream.time_base = MICROSECONDS
        stream.codec_context.time_base = MICROSECONDS
        stream.codec_context.gop_size = 20
        stream.codec_context.thread_count = 1
        self._stream, self._size, self._first_stamp = stream, (width, height), stamp_ns
        self._pixels = pixels.codec


def _codec(pixels: Pixels, preset: str, quality: str) -> tuple[str, str, dict[str, str]]:
    """FFmpeg's encoder, its pixel format and options."""
    if pixels.codec == "png":
        layout = "gray16be" if pixels.format == "gray16le" else pixels.format
        return "png", layout, {"compression_level": "1", "pred": "up"}
    # No look-ahead and no B-frames: a frame that went in comes out at once.
    options = {"preset": preset, "tune": "zerolatency", "bf": "0"}
    if quality != LOSSLESS:
        return "libx264", "yuv420p", {**options, "crf": quality}
    if pixels.format == "yuyv422":
        return "libx264", "yuv422p", {**options, "qp": "0"}
    return "libx264rgb", "rgb24", {**options, "qp": "0"}


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
        pixels = _FORMATS[code]
        try:
            image = (
                rows_of(data, width, height, step, pixels.size) if pixels.size else decoded(data)
            )
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
    """``video_encoder.py VIDEO SIDECAR PRESET QUALITY``; returns the exit code."""
    # Ctrl-C reaches the whole terminal group: the end of the input is the only stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
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
