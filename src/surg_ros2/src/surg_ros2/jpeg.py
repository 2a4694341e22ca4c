"""A raw picture as JPEG."""

from __future__ import annotations

import io
from typing import Any

from PIL import Image

QUALITY = 85  # of 100
_MODES = {"rgb8": ("RGB", "RGB", 3), "bgr8": ("RGB", "BGR", 3), "mono8": ("L", "L", 1)}
"""Encoding in ROS -> mode of the picture, order of its bytes, bytes per pixel."""


def encode(image: Any) -> bytes | None:
    """The JPEG of a picture like a sensor_msgs/Image; None: not of 8 bits a colour, or cut."""
    mode, order, size = _MODES.get(image.encoding, ("", "", 0))
    if not size or len(image.data) < image.step * image.height or image.step < size * image.width:
        return None
    shape = (image.width, image.height)
    picture = Image.frombytes(mode, shape, bytes(image.data), "raw", order, image.step)
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=QUALITY)
    return file.getvalue()
