"""Pictures and camera model of the endoscope, from topics."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import Any

import numpy as np
import rosgraph
import rospy
from sensor_msgs.msg import CameraInfo, Image

from surg_ros.peers import publishers
from surg_teleop.frames.frame_check import Pair
from surg_teleop.frames.registration_verdict import Lens
from surg_teleop.frames.tip_tracker import Picture
from surg_teleop.frames.undistortion import EyeModel

EYES = ("left", "right")
KEPT = 8
"""Pictures of an eye that may wait for the other eye."""


class EndoscopePictures:
    """Pictures of one or two cameras, paired by their stamps."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.newest: Pair | None = None  # newest complete set
        self.problem = ""  # why the pictures cannot be used; empty: they can
        self._waiting: dict[str, OrderedDict[int, Picture]] = {n: OrderedDict() for n in names}
        self._infos: dict[str, CameraInfo] = {}
        self.inputs = []
        for name in names:
            root = f"/endoscope/{name}"
            keys: dict[str, Any] = {"tcp_nodelay": True, "buff_size": 1 << 24}
            self.inputs += [
                rospy.Subscriber(f"{root}/image_raw", Image, self._on_image, name, **keys),
                rospy.Subscriber(f"{root}/camera_info", CameraInfo, self._on_info, name, **keys),
            ]

    def _on_info(self, message: CameraInfo, name: str) -> None:
        self._infos[name] = message

    def _on_image(self, message: Image, name: str) -> None:
        picture = decode(message)
        if picture is None:
            self.problem = (
                f"/endoscope/{name}/image_raw has encoding '{message.encoding}'; allowed: rgb8 "
                "and bgr8"
            )
            return
        waiting = self._waiting[name]
        waiting[message.header.stamp.to_nsec()] = picture
        while len(waiting) > KEPT:
            waiting.popitem(last=False)
        stamps = set.intersection(*(set(w) for w in self._waiting.values()))
        if stamps:
            stamp = max(stamps)
            pictures = [self._waiting[n][stamp] for n in self.names]
            self.newest = Pair(stamp, pictures[0], pictures[1] if len(pictures) > 1 else None)

    def lens(self) -> Lens | None:
        """Camera model; None: camera_info has not arrived yet, or nobody has measured the lens."""
        if set(self._infos) != set(self.names) or not self._infos["left"].K[0]:
            return None
        left = self._infos["left"]
        baseline = 0.0
        if "right" in self._infos:
            P = self._infos["right"].P
            baseline = abs(P[3] / P[0]) if P[0] else 0.0
        return Lens(left.K[0], np.array([left.K[2], left.K[5]]), baseline)

    def eyes(self) -> tuple[EyeModel, EyeModel | None]:
        """Both eyes as their camera_info states them; None: there is one.

        Raises:
            KeyError: A camera_info has not arrived yet.
        """
        left = _eye(self._infos["left"])
        return left, _eye(self._infos["right"]) if "right" in self.names else None


def _eye(info: CameraInfo) -> EyeModel:
    K, R = (np.array(values, dtype=np.float64).reshape(3, 3) for values in (info.K, info.R))
    if not R.any():  # nobody has filled it in
        R = np.eye(3)
    return EyeModel(K, np.array(info.D, dtype=np.float64), info.distortion_model, R)


def decode(message: Image) -> Picture | None:
    """Pixels (h, w, 3) in rgb8; None: the encoding is unknown."""
    if message.encoding not in ("rgb8", "bgr8"):
        return None
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    picture = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return picture if message.encoding == "rgb8" else picture[..., ::-1]


def wait_for_eyes(count: int, timeout: float) -> tuple[str, ...]:
    """Wait for the endoscope's pictures; returns the names of the eyes that are published.

    Raises:
        TimeoutError: The left eye is not published.
    """
    master, name = rosgraph.get_master_uri(), rospy.get_name()

    def published() -> tuple[str, ...]:
        eyes = EYES[:count]
        return tuple(e for e in eyes if publishers(master, name, f"/endoscope/{e}/image_raw"))

    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline and not rospy.is_shutdown():
        if "left" in published():
            time.sleep(0.2)  # the second eye is advertised right after the first
            return published()
        time.sleep(0.05)
    raise TimeoutError(
        "nobody publishes /endoscope/left/image_raw; start the endoscope: './surg up CELL' does "
        "unless --no-video is given"
    )
