"""Collects calibration views from a running system: topics in, ``/calibrate/status`` out.

It moves nothing. Pictures of the newest pair only; a pair has one stamp. The node is part of
``./surg calibrate CELL stereo|handeye --live``, which starts a step, and of ``live``, which waits
for ``/calibrate/request``.
"""

from __future__ import annotations

import threading
from typing import Any

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from surg_msgs.msg import CalibrationRequest, CalibrationStatus
from surg_perception.calibration.board import Picture
from surg_perception.collecting import collector
from surg_perception.collecting.arm_joints_node import SILENT_S, ArmJoints
from surg_perception.collecting.collector import CalibrationStep
from surg_perception.collecting.live_calibration import CalibrationState, LiveCalibration, Status
from surg_perception.stereo.newest_pair_node import EYES, NewestPair

GREY = {"rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY, "mono8": None}
REPORT_S = 0.2


class CollectViews:
    """The node's topics around a calibration."""

    def __init__(self, live: LiveCalibration) -> None:
        self._live = live
        self._pairs = NewestPair()
        self._lock = threading.Lock()
        self._joints: ArmJoints | None = None
        self._seen = rospy.get_time()
        self._requests: list[int] = []
        self._status = rospy.Publisher(
            "/calibrate/status", CalibrationStatus, queue_size=10, latch=True
        )
        self._inputs = [
            rospy.Subscriber("/calibrate/request", CalibrationRequest, self._on_request),
            rospy.Subscriber("/endoscope/left/camera_info", CameraInfo, self._on_info),
        ]

    def start(self, step: CalibrationStep) -> None:
        """Begin a step; raises as `LiveCalibration.start`."""
        self._live.start(step)
        self._seen = rospy.get_time()
        self._pairs.listen(False)
        self._pairs = NewestPair(EYES[: self._live.eyes])
        self._pairs.listen(True)
        if self._joints is not None:
            self._joints.close()
        arm = self._live.arm
        self._joints = None if arm is None else ArmJoints(arm)

    def _on_request(self, message: CalibrationRequest) -> None:
        with self._lock:
            self._requests.append(message.request)
        self._pairs.wake()

    def _on_info(self, message: CameraInfo) -> None:
        self._live.lens(np.array(message.K).reshape(3, 3))

    def turn(self, wait: float = REPORT_S) -> Status:
        """Look at the newest pair, if one arrives in time [s], and publish the status."""
        pair = self._pairs.take(wait)
        with self._lock:
            requests, self._requests = self._requests, []
        for request in requests:
            self._obey(request)
        if pair is not None:
            self._look(pair)
        elif self._live.status.state is CalibrationState.COLLECTING:
            self._silence()
        self._live.step_on(self._report)
        self._report()
        return self._live.status

    def _look(self, pair: tuple[Image, ...]) -> None:
        try:
            pictures = tuple(grey_of(image) for image in pair)
        except ValueError as error:
            self._live.say(str(error))
            return
        self._seen = rospy.get_time()
        stamp = pair[0].header.stamp.to_sec()
        arm, listening = self._live.arm, self._joints
        if arm is None or listening is None:
            self._live.see(stamp, pictures)
            return
        if listening.silent(stamp):
            self._live.say(f"{arm.name} states no joints ({listening.topic}).")
            return
        self._live.see(stamp, pictures, listening.resting(stamp))

    def _silence(self) -> None:
        """Tell the person that pictures are missing."""
        now = rospy.get_time()
        if now - self._seen > SILENT_S:
            silent = self._pairs.silent()
            if silent:
                which = " and ".join(f"/endoscope/{eye}/image_raw" for eye in silent)
                self._live.say(f"No pictures on {which}. Start the endoscope's node.")
            else:
                self._live.say("The endoscope is silent, or its eyes have different stamps.")

    def _obey(self, request: int) -> None:
        starts = {
            CalibrationRequest.START_STEREO: CalibrationStep.STEREO,
            CalibrationRequest.START_HANDEYE: CalibrationStep.HANDEYE,
        }
        if request in starts:
            try:
                self.start(starts[request])
            except (ValueError, OSError) as error:
                self._live.refuse(str(error))
        elif request == CalibrationRequest.UNDO:
            self._live.undo()
        elif request == CalibrationRequest.SOLVE:
            self._live.ask_to_solve()

    def _report(self) -> None:
        self._status.publish(status_message(self._live.status))

    def close(self) -> None:
        """Leave the graph."""
        self._pairs.listen(False)
        if self._joints is not None:
            self._joints.close()
        for each in (*self._inputs, self._status):
            each.unregister()


def grey_of(image: Any) -> Picture:
    """A picture (h, w), grey.

    Raises:
        ValueError: It has another encoding.
    """
    if image.encoding not in GREY:
        raise ValueError(f"Pictures are {image.encoding!r}; allowed: {', '.join(GREY)}.")
    channels = 1 if image.encoding == "mono8" else 3
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
    picture = rows[:, : channels * image.width].reshape(image.height, image.width, channels)
    code = GREY[image.encoding]
    grey = picture[..., 0] if code is None else cv2.cvtColor(picture, code)
    return np.ascontiguousarray(grey, dtype=np.uint8)


def status_message(status: Status) -> CalibrationStatus:
    """The status as a message."""
    message = CalibrationStatus(
        version=CalibrationStatus.VERSION,
        state=getattr(CalibrationStatus, f"STATE_{status.state.name}"),
        step=getattr(CalibrationStatus, f"STEP_{status.step.name if status.step else 'NONE'}"),
        columns=collector.COLUMNS,
        rows=collector.ROWS,
        **{name: value for name, value in vars(status).items() if name not in ("state", "step")},
    )
    message.header.stamp = rospy.Time.now()
    return message
