"""Pictures in encodings that the recorder does not take, as pictures that it takes."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt

from surg_recording.imports.ledger import Ledger
from surg_recording.video.colours import Colours
from surg_recording.video.compressed_image import read_header
from surg_recording.video.image_frame import frame_of
from surg_recording.video.video_encoder import ENCODINGS
from surg_recording.video.video_sink import unusable

Values = npt.NDArray[Any]

_BAYER = {
    "rggb": cv2.COLOR_BayerBG2RGB,  # OpenCV names a pattern by its second row
    "bggr": cv2.COLOR_BayerRG2RGB,
    "gbrg": cv2.COLOR_BayerGR2RGB,
    "grbg": cv2.COLOR_BayerGB2RGB,
}
_YUV = {
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "nv12": (1, cv2.COLOR_YUV2RGB_NV12),
    "nv21": (1, cv2.COLOR_YUV2RGB_NV21),
    "i420": (1, cv2.COLOR_YUV2RGB_I420),
}
"""Encoding → bytes of a pixel in the rows, and OpenCV's conversion. Half as many rows of chroma
follow those of one byte."""
_WIDE = {"rgb16": 3, "bgr16": 3, "16UC3": 3, "rgba16": 4, "bgra16": 4, "16UC4": 4}
"""Encoding → colours of 16 bits; red comes first where the name begins with it."""
B_PICTURE = 3
"""FFmpeg's number of a picture that needs a later one."""
_STREAMS = ("h264", "hevc", "h265")
_DEPTH_HEAD = struct.Struct("<iff")
"""Of compressed_depth_image_transport: kind, and the two numbers of its inverse depth."""


class PictureDecoder:
    """The pictures of one camera; stateful, because a video stream's pictures need one another."""

    def __init__(self, camera: str, ledger: Ledger) -> None:
        self._camera, self._ledger = camera, ledger
        self._codec: Any = None
        self._colours = Colours()

    def __call__(self, message: Any) -> Any | None:
        """A message that the recorder takes; None: it cannot be decoded, which is counted."""
        try:
            made = self._compressed(message) if hasattr(message, "format") else _raw(message)
            if made is not message:
                made.header = message.header
                was = getattr(message, "format", None) or getattr(message, "encoding", "?")
                self._ledger.converted.setdefault(self._camera, f"{was} to {made.encoding}")
            reason = unusable(frame_of(made, 0, 0))
        except (ValueError, cv2.error, av.error.FFmpegError, struct.error) as problem:
            reason = " ".join(str(problem).split())
        if reason is not None:
            self._ledger.drop(self._camera, f"cannot be decoded: {reason}")
            return None
        return made

    def _compressed(self, message: Any) -> Any:
        stated, data = str(message.format), bytes(message.data)
        kind = stated.partition(";")[2].strip() or stated
        if "compressedDepth" in stated:
            return _depth(stated, data)
        name = next((name for name in _STREAMS if name in kind.lower()), None)
        if name is not None:
            return self._streamed("hevc" if name == "h265" else name, data)
        if stated.startswith("bayer_"):  # image_transport keeps the mosaic
            made = image_message(_opened(data))
            if made.encoding in ("mono8", "16UC1"):
                made.encoding = stated.partition(";")[0].strip()
            return _raw(made)
        return image_message(_opened(data))

    def _streamed(self, codec: str, data: bytes) -> Any:
        """The picture of one packet of a video stream."""
        if self._codec is None:
            self._codec = av.CodecContext.create(codec, "r")
            self._codec.thread_count = 1  # one packet in, one picture out
            self._codec.options = {"flags": "+low_delay"}
        frames = self._codec.decode(av.Packet(data))
        if not frames:
            raise ValueError(f"a packet of {codec} without a picture")
        if any(int(frame.pict_type) == B_PICTURE for frame in frames):
            raise ValueError(f"{codec} with B-frames, which come late; allowed: without (-bf 0)")
        return image_message(self._colours(frames[-1]), rgb=True)


def _opened(data: bytes) -> Values:
    """A compressed picture as OpenCV reads it (colours: b, g, r), with all its bits."""
    if data.startswith((b"\xff\xd8", b"\x89PNG")):
        read_header(data, most_bits=16)  # OpenCV fills what is cut with grey
    opened = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if opened is None:
        raise ValueError(f"no picture that OpenCV reads ({len(data)} bytes)")
    return np.asarray(opened)


def image_message(values: Values, rgb: bool = False) -> SimpleNamespace:
    """Pixels (height, width[, channels]) as an image message; colours: b, g, r, or ``rgb``."""
    channels = 1 if values.ndim == 2 else values.shape[2]
    if values.dtype == np.uint16 and channels > 1:
        values = (values >> 8).astype(np.uint8)
    kinds: dict[tuple[str, int], str] = {
        ("uint8", 1): "mono8",
        ("uint8", 3): "rgb8" if rgb else "bgr8",
        ("uint8", 4): "rgba8" if rgb else "bgra8",
        ("uint16", 1): "16UC1",
        ("float32", 1): "32FC1",
    }
    encoding = kinds.get((values.dtype.name, channels))
    if encoding is None:
        raise ValueError(f"{channels} channels of {values.dtype.name}")
    height, width = values.shape[:2]
    return SimpleNamespace(
        width=width,
        height=height,
        step=width * channels * values.dtype.itemsize,
        encoding=encoding,
        is_bigendian=0,
        data=values.tobytes(),
    )


def _raw(message: Any) -> Any:
    """An image message whose encoding the recorder knows."""
    encoding = str(message.encoding)
    if encoding in ENCODINGS:
        return message
    if encoding in _YUV:
        size, code = _YUV[encoding]
        rows = message.height if size == 2 else message.height * 3 // 2
        pixels = _rows(message, rows, size, np.uint8)
        return image_message(cv2.cvtColor(pixels if size == 2 else pixels[..., 0], code), rgb=True)
    kind, pattern, bits = encoding.partition("_")[0], encoding[6:10], encoding[10:]
    if kind == "bayer" and pattern in _BAYER and bits in ("8", "16"):
        dtype = np.uint8 if bits == "8" else np.uint16
        grey = _rows(message, message.height, 1, dtype)[..., 0]
        return image_message(cv2.cvtColor(grey, _BAYER[pattern]), rgb=True)
    if encoding in _WIDE:
        wide = _rows(message, message.height, _WIDE[encoding], np.uint16)
        return image_message(wide, rgb=encoding.startswith("rgb"))
    if encoding == "8UC4":
        return image_message(_rows(message, message.height, 4, np.uint8))
    known = [*ENCODINGS, *_YUV, *_WIDE, "8UC4", *(f"bayer_{p}{b}" for p in _BAYER for b in (8, 16))]
    raise ValueError(f"encoding {encoding!r}; allowed: {', '.join(known)}")


def _rows(message: Any, height: int, channels: int, dtype: Any) -> Values:
    """The pixels (height, width, channels) of a message, without the ends of its rows."""
    kind = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * channels * kind.itemsize
    if message.step < used or len(message.data) != message.step * height or message.width < 2:
        raise ValueError(
            f"image of {message.width}x{message.height} pixels, {message.step} bytes per row and"
            f" {len(message.data)} bytes does not add up"
        )
    rows = np.frombuffer(message.data, np.uint8).reshape(height, message.step)[:, :used]
    pixels = np.ascontiguousarray(rows).view(kind).reshape(height, message.width, channels)
    return pixels.astype(dtype)


def _depth(stated: str, data: bytes) -> SimpleNamespace:
    """A picture of compressed_depth_image_transport: millimetres, or metres as inverse depth."""
    _, a, b = _DEPTH_HEAD.unpack_from(data)
    if "rvl" in stated.lower():
        raise ValueError("compressedDepth of kind RVL; allowed: PNG. Republish it as compressed")
    values = _opened(data[_DEPTH_HEAD.size :])
    if not stated.startswith("32FC1"):
        return image_message(values)
    if not a:
        raise ValueError("compressedDepth without the numbers of its inverse depth")
    with np.errstate(divide="ignore"):
        metres = np.where(values == 0, np.nan, a / (values.astype(np.float64) - b))
    return image_message(metres.astype(np.float32))
