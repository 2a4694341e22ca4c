"""Messages of an endoscope that a test plays."""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_core.lens_file import Lens


def image(picture: np.ndarray, stamp: Any, frame: str) -> Any:
    """The message of a picture (h, w, 3)."""
    from sensor_msgs.msg import Image

    height, width, _ = picture.shape
    message = Image(height=height, width=width, step=3 * width, encoding="rgb8")
    message.header.stamp, message.header.frame_id = stamp, frame
    message.data = picture.tobytes()
    return message


def camera_info(lens: Lens, stamp: Any) -> Any:
    """The camera_info of a lens."""
    from sensor_msgs.msg import CameraInfo

    info = CameraInfo(**lens.camera_info)
    info.header.stamp, info.header.frame_id = stamp, lens.camera_name
    return info
