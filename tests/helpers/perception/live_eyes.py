"""Messages of an endoscope that a test plays."""

from __future__ import annotations

from typing import Any

from surg_core.lens_file import Lens


def camera_info(lens: Lens, stamp: Any) -> Any:
    """The camera_info of a lens."""
    from sensor_msgs.msg import CameraInfo

    info = CameraInfo(width=lens.width, height=lens.height, distortion_model=lens.distortion_model)
    info.header.stamp, info.header.frame_id = stamp, lens.camera_name
    info.D, info.K = lens.D.tolist(), lens.K.ravel().tolist()
    info.R, info.P = lens.R.ravel().tolist(), lens.P.ravel().tolist()
    return info
