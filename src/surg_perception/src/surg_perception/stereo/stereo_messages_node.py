"""Messages of the node ``/eyes``: pictures, depth, points, and what it reads."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

from surg_core.lens_file import Lens
from surg_core.pictures.camera_model import lens_of
from surg_core.transforms import FloatArray
from surg_perception.depth.rectification import Picture

RGB = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0)}
"""Encodings that are read, and where red, green and blue stand."""


def picture_of(message: Image) -> Picture:
    """(h, w, 3) rgb8 of a message.

    Raises:
        ValueError: Another encoding, or too few bytes.
    """
    order = RGB.get(message.encoding)
    if order is None:
        raise ValueError(f"pictures of {message.encoding!r}; allowed: {', '.join(RGB)}")
    height, width, step = message.height, message.width, message.step
    if step < 3 * width or len(message.data) < height * step or not height * width:
        raise ValueError(f"a picture of {width} x {height} with {len(message.data)} bytes")
    rows = np.frombuffer(message.data, np.uint8, height * step).reshape(height, step)
    picture = rows[:, : 3 * width].reshape(height, width, 3)
    return picture if order == (0, 1, 2) else np.ascontiguousarray(picture[..., ::-1])


def lens_of_message(name: str, info: CameraInfo) -> Lens:
    """The lens of a camera_info; errors as `lens_of`."""
    keys = ("width", "height", "distortion_model", "D", "K", "R", "P")
    model = {key: getattr(info, key) for key in keys}
    listed = {k: list(v) if isinstance(v, (list, tuple)) else v for k, v in model.items()}
    return lens_of(f"/endoscope camera_info of {name}", name, listed)


def image_of(header: Header, picture: Picture) -> Image:
    """A message of a picture (h, w, 3), rgb8."""
    height, width, _ = picture.shape
    data = np.ascontiguousarray(picture).tobytes()
    return Image(
        header=header, height=height, width=width, encoding="rgb8", step=3 * width, data=data
    )


def depth_of(header: Header, depth: npt.NDArray[np.float32]) -> Image:
    """A message of depths (h, w) [m], NaN where unknown."""
    height, width = depth.shape
    data = np.ascontiguousarray(depth, "<f4").tobytes()
    return Image(
        header=header, height=height, width=width, encoding="32FC1", step=4 * width, data=data
    )


def cloud_of(
    header: Header, points: npt.NDArray[np.float32], colours: Picture, R: FloatArray
) -> PointCloud2:
    """A message of the known points.

    Args:
        header: Of the left eye's picture.
        points: (h, w, 3) in the rectified left eye [m]; NaN: unknown.
        colours: (h, w, 3) rgb8.
        R: (3, 3) from the left eye to its rectified one: the message is in the left eye's frame.
    """
    known = np.isfinite(points[..., 2])
    rows = np.zeros(int(known.sum()), [("p", "<f4", 3), ("rgb", "<u4")])
    rows["p"] = points[known] @ R.astype(np.float32)
    red, green, blue = (colours[known][:, n].astype(np.uint32) for n in range(3))
    rows["rgb"] = red << 16 | green << 8 | blue
    fields = [PointField(name, 4 * n, PointField.FLOAT32, 1) for n, name in enumerate("xyz")]
    fields.append(PointField("rgb", 12, PointField.FLOAT32, 1))
    return PointCloud2(
        header=header,
        height=1,
        width=len(rows),
        fields=fields,
        point_step=16,
        row_step=16 * len(rows),
        data=rows.tobytes(),
        is_dense=True,
    )
