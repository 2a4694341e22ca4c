"""Pictures in the encodings of cameras' drivers, as messages of ROS."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header


def mosaic(image: np.ndarray[Any, Any], pattern: str) -> np.ndarray[Any, Any]:
    """What a sensor with this pattern of colour filters sees."""
    seen = np.zeros(image.shape[:2], np.uint8)
    for place, colour in enumerate(pattern):
        row, column = divmod(place, 2)
        seen[row::2, column::2] = image[row::2, column::2, "rgb".index(colour)]
    return seen


def yuv(image: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Y, U, V by BT.601, limited range."""
    r, g, b = (image[..., i].astype(float) for i in range(3))
    y = 16 + (65.481 * r + 128.553 * g + 24.966 * b) / 255
    u = 128 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255
    v = 128 + (112.0 * r - 93.786 * g - 18.214 * b) / 255
    return np.stack([y, u, v], axis=-1).round().astype(np.uint8)


def uyvy(image: np.ndarray[Any, Any], order: str) -> bytes:
    """Two pixels in four bytes."""
    planes, packed = yuv(image), np.zeros((*image.shape[:2], 2), np.uint8)
    luma, chroma = (1, 0) if order == "uyvy" else (0, 1)
    packed[..., luma] = planes[..., 0]
    packed[:, 0::2, chroma], packed[:, 1::2, chroma] = planes[:, 0::2, 1], planes[:, 0::2, 2]
    return packed.tobytes()


def raw(encoding: str, image: np.ndarray[Any, Any]) -> Image | CompressedImage:
    """An RGB picture in an encoding; with ``; png`` and ``; jpeg`` as image_transport packs it."""
    height, width = image.shape[:2]
    step = width
    if encoding.endswith("; jpeg"):
        coded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        return CompressedImage(format="rgb8; jpeg compressed bgr8", data=coded.tobytes())
    if encoding.endswith("; png"):
        mosaicked = mosaic(image, encoding[6:10]).astype(
            np.uint16 if "16" in encoding else np.uint8
        )
        content = cv2.imencode(".png", mosaicked * (257 if "16" in encoding else 1))[1].tobytes()
        return CompressedImage(format=f"{encoding} compressed ", data=content)
    if encoding.startswith("bayer"):
        data = mosaic(image, encoding[6:10])
        wide = encoding.endswith("16")
        data, step = (data.astype("<u2") * 257, 2 * width) if wide else (data, width)
        content = data.tobytes()
    elif encoding in ("yuv422", "uyvy", "yuyv"):
        content, step = uyvy(image, "yuyv" if encoding == "yuyv" else "uyvy"), 2 * width
    elif encoding == "rgb16":
        content, step = (image.astype("<u2") * 257).tobytes(), width * 6
    elif encoding == "bgr8":
        content, step = image[..., ::-1].tobytes(), width * 3
    elif encoding == "16UC3":
        content, step = (image[..., ::-1].astype("<u2") * 257).tobytes(), width * 6
    elif encoding == "nv12":
        planes = yuv(image)
        content = planes[..., 0].tobytes() + planes[::2, ::2, 1:].tobytes()
    else:
        blank = np.full((height, width, 1), 255, np.uint8)
        content, step = np.dstack([image[..., ::-1], blank]).tobytes(), 4 * width
    return Image(Header(), height, width, encoding, 0, step, content)


BAYER = [f"bayer_{p}{b}" for p in ("rggb", "bggr", "gbrg", "grbg") for b in ("8", "16")]
OTHERS = ["bgr8", "yuv422", "uyvy", "yuyv", "nv12", "rgb16", "8UC4", "16UC3"]
OTHERS += ["bayer_grbg8; png", "bayer_rggb16; png"]
