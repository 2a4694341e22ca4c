"""``ros:/left,/right``: the pictures of another driver, raw or compressed, with its stamps."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CompressedImage, Image

from surg_perception.capture import picture_source
from surg_perception.capture.picture_source import Grabbed, PictureSource, SourceError, Wanted

ENCODINGS = {"rgb8": None, "bgr8": cv2.COLOR_BGR2RGB, "mono8": cv2.COLOR_GRAY2RGB}
SILENT_S = 2.0


class RosSource(PictureSource):
    """One image topic; a name that ends in ``/compressed`` carries sensor_msgs/CompressedImage."""

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self._where = f"endoscope.source: ros:{address}"
        if not rospy.core.is_initialized():
            rospy.init_node("endoscope_source", anonymous=True, disable_signals=True)
        kind: Any = CompressedImage if address.endswith("/compressed") else Image
        self._arrived: queue.Queue[tuple[int, Any]] = queue.Queue(maxsize=2)
        self._subscriber = rospy.Subscriber(
            address, kind, self._on_picture, queue_size=2, buff_size=1 << 25, tcp_nodelay=True
        )

    @classmethod
    def devices(cls, address: str) -> list[str]:
        """The topics of the eyes, divided by a comma."""
        return address.split(",")

    def _on_picture(self, message: Any) -> None:
        if self._arrived.full():  # the newest count
            self._arrived.get()
        self._arrived.put((self.wanted.now(), message))

    def pictures(self) -> Iterator[Grabbed]:
        """Every picture that arrives; a SourceError ``gone`` where none does."""
        while True:
            try:
                received, message = self._arrived.get(timeout=SILENT_S)
            except queue.Empty:
                raise SourceError(
                    "gone",
                    f"{self._where}: nobody publishes pictures on it; start its driver, or "
                    "correct the name (rostopic list)",
                ) from None
            stamp = message.header.stamp.to_nsec() or received
            yield Grabbed(stamp, received, (self._decoded(message),), self._jpegs(message))

    def _jpegs(self, message: Any) -> tuple[bytes, ...]:
        coded = self.wanted.coded and isinstance(message, CompressedImage)
        return (bytes(message.data),) if coded and "jpeg" in message.format else ()

    def _decoded(self, message: Any) -> picture_source.Image:
        if isinstance(message, CompressedImage):
            flat: Any = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
            if flat is None:
                raise self._refusal(f"format {message.format!r}", "jpeg or png")
            return np.asarray(cv2.cvtColor(flat, cv2.COLOR_BGR2RGB), np.uint8)
        if message.encoding not in ENCODINGS:
            raise self._refusal(f"encoding {message.encoding!r}", ", ".join(ENCODINGS))
        channels = 1 if message.encoding == "mono8" else 3
        rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        picture: Any = rows[:, : channels * message.width].reshape(
            message.height, message.width, channels
        )
        code = ENCODINGS[message.encoding]
        return np.asarray(picture if code is None else cv2.cvtColor(picture, code), np.uint8)

    def _refusal(self, found: str, allowed: str) -> SourceError:
        return SourceError(
            "wrong_format", f"{self._where}: pictures have {found}; allowed: {allowed}"
        )

    def close(self) -> None:
        """End the subscription."""
        self._subscriber.unregister()
