"""Encodes pictures as H.264 and JPEG without delay: no look-ahead, no B frames."""

from __future__ import annotations

import fractions
from dataclasses import dataclass

import av
import numpy as np
from numpy.typing import NDArray

try:
    import cv2
except ImportError:  # the first set of packages does without it
    cv2 = None

Image = NDArray[np.uint8]

if cv2 is not None:
    cv2.setNumThreads(1)  # leaves the other cores to the controller

PIXELS = {"rgb8": ("rgb24", 3), "bgr8": ("bgr24", 3), "mono8": ("gray", 1)}
"""ROS image encoding → PyAV pixel format and channels."""
_TO_YUV = {"rgb8": "COLOR_RGB2YUV_I420", "bgr8": "COLOR_BGR2YUV_I420"}
"""OpenCV converts four times faster than ffmpeg; both use ITU-R BT.601, 16 to 235."""
KEY_EVERY = 100
"""Pictures between two key pictures; a page that joins or falls behind requests one."""
_ANY, _KEY = 0, 1
"""Types of a picture by FFmpeg's numbers, which every version of PyAV takes: none wanted, I."""
_MICROSECONDS = fractions.Fraction(1, 1_000_000)


class CodecError(ValueError):
    """An image that cannot be encoded: why and what is allowed."""


@dataclass(frozen=True)
class Format:
    """How ffmpeg encodes a picture."""

    library: str
    pixels: str
    options: dict[str, str]


CODECS = {
    # Low-latency x264: constrained baseline, Annex B, parameter sets with every key picture.
    "h264": Format(
        "libx264",
        "yuv420p",
        {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "bf": "0",
            "crf": "21",
            "forced-idr": "1",
            "x264-params": "scenecut=0:repeat-headers=1:annexb=1:sliced-threads=0:"
            "colorprim=smpte170m:transfer=smpte170m:colormatrix=smpte170m",
        },
    ),
    # Four to eight times the bytes of H.264, decoded by every browser. Quality 4 of 2 (best) to 31,
    # in ffmpeg's unit FF_QP2LAMBDA.
    "jpeg": Format("mjpeg", "yuvj420p", {"flags": "+qscale", "global_quality": str(4 * 118)}),
}


class Codec:
    """Encodes pictures of one size; H.264 needs even sides.

    Args:
        name: Of CODECS.
        size: Width and height [px].
    """

    def __init__(self, name: str, size: tuple[int, int]) -> None:
        self.size = size
        self._format = CODECS[name]
        context = av.CodecContext.create(self._format.library, "w")
        context.width, context.height = size
        context.pix_fmt, context.thread_count = self._format.pixels, 1
        context.time_base, context.framerate = _MICROSECONDS, fractions.Fraction(20)
        context.gop_size, context.options = KEY_EVERY, self._format.options
        self._context = context
        self._last = -1

    def encode(self, frame: av.VideoFrame, stamp_us: int, key: bool) -> bytes:
        """Encode one picture; `key`: make it a key picture, as every JPEG is."""
        picture = frame.reformat(format=self._format.pixels)
        self._last = max(stamp_us, self._last + 1)
        picture.pts, picture.time_base = self._last, _MICROSECONDS
        picture.pict_type = _KEY if key else _ANY
        return b"".join(bytes(packet) for packet in self._context.encode(picture))


def image_of(data: bytes, width: int, height: int, step: int, encoding: str) -> Image:
    """Pixels of a ROS image, without a copy if its rows are packed; `step`: bytes per row.

    Returns:
        (height, width, channels), or (height, width) of a grey image. H.264 needs even sizes, so an
        odd last row or column is cut off.

    Raises:
        CodecError: Size, step and data do not match, or the encoding is unknown.
    """
    if encoding not in PIXELS:
        raise CodecError(f"image encoding '{encoding}'; allowed: {', '.join(PIXELS)}")
    channels = PIXELS[encoding][1]
    if width < 16 or height < 16 or step < width * channels or len(data) != step * height:
        raise CodecError(
            f"an image of {width} x {height} pixels with {step} bytes per row cannot have "
            f"{len(data)} bytes"
        )
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, : width * channels]
    even_width, even_height = width & ~1, height & ~1
    if channels == 1:
        return rows[:even_height, :even_width]
    return rows.reshape(height, width, channels)[:even_height, :even_width]


def frame_of(images: tuple[Image, ...], encoding: str) -> av.VideoFrame:
    """Input of the encoder: one picture, or two side by side.

    Raises:
        CodecError: The two differ in size.
    """
    if len({image.shape for image in images}) != 1:
        raise CodecError("left and right picture differ in size")
    whole = np.ascontiguousarray(np.hstack(images) if len(images) > 1 else images[0])
    if cv2 is not None and encoding in _TO_YUV:
        yuv = np.asarray(cv2.cvtColor(whole, getattr(cv2, _TO_YUV[encoding])))
        return av.VideoFrame.from_ndarray(yuv, format="yuv420p")
    return av.VideoFrame.from_ndarray(whole, format=PIXELS[encoding][0])


def half_size(image: Image) -> Image:
    """The image at half its width and height, whose sides stay even."""
    height, width = (side // 4 * 4 for side in image.shape[:2])
    whole = image[:height, :width]
    if cv2 is None:
        return np.ascontiguousarray(whole[::2, ::2])
    return np.asarray(cv2.resize(whole, (width // 2, height // 2), interpolation=cv2.INTER_AREA))


def profile_of(data: bytes) -> tuple[int, int, int]:
    """Profile, constraints and level of an H.264 key picture; zeros if it has no parameter set.

    They configure the browser's decoder (``avc1.PPCCLL``).
    """
    at = data.find(b"\x00\x00\x01")
    while at >= 0 and at + 7 <= len(data):
        if data[at + 3] & 0x1F == 7:
            return data[at + 4], data[at + 5], data[at + 6]
        at = data.find(b"\x00\x00\x01", at + 3)
    return 0, 0, 0
