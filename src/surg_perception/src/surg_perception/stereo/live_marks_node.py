"""Marks of all instruments at the time of a picture, live: as values, and as a topic."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, JointState

import surg_core
from surg_core.lens_file import Lens
from surg_core.transforms import FloatArray
from surg_msgs.msg import PictureMark as MarkMessage
from surg_msgs.msg import PictureMarks
from surg_perception.marks.mark_projection import MarkProjection, PictureMark
from surg_perception.stereo.joint_history import JointHistory
from surg_perception.stereo.newest_pair_node import EYES
from surg_ros.joint_order import positions_of

TOPIC = "/endoscope/marks"


class Joints:
    """Joint states of the arms that marks need."""

    def __init__(self, cell: surg_core.Cell) -> None:
        self._lock = threading.Lock()
        self._of = {name: JointHistory() for name in cell.arms}
        self._jaw = {name: JointHistory() for name in cell.arms}
        self._subscribers: list[Any] = []
        for name, arm in cell.arms.items():
            names = list(arm.robot.joint_names)
            self._listen(f"/{name}/robot/measured_js", self._of[name], names)
            self._listen(f"/{name}/jaw/measured_js", self._jaw[name], [])

    def _listen(self, topic: str, history: JointHistory, names: list[str]) -> None:
        keep = self._keep(history, names)
        self._subscribers.append(
            rospy.Subscriber(topic, JointState, keep, queue_size=100, tcp_nodelay=True)
        )

    def _keep(self, history: JointHistory, wanted: list[str]) -> Callable[[JointState], None]:
        def keep(message: JointState) -> None:
            q = positions_of(message, wanted)
            if q and len(q) == (len(wanted) or 1):
                with self._lock:
                    history.add(message.header.stamp.to_nsec(), np.array(q))

        return keep

    def at(self, arm: str, stamp_ns: int) -> tuple[np.ndarray | None, float]:
        """Joints (n,) [rad], None: not known, and jaw [rad], NaN: not known, at a time."""
        with self._lock:
            q, jaw = self._of[arm].at(stamp_ns), self._jaw[arm].at(stamp_ns)
        return q, float("nan") if jaw is None else float(jaw[0])

    def between(self, arm: str, stamp_ns: int) -> FloatArray | None:
        """Joints (n,) [rad] at a time with a state on both sides of it; None: not known."""
        with self._lock:
            return self._of[arm].between(stamp_ns)


class LiveMarks:
    """Where joints and calibration put all instruments. Any thread may call it.

    Publishes them for each stamp of the left eye's camera_info, which comes with every picture.

    Attributes:
        withheld: Why there are none: the calibration puts them beside their place.
    """

    def __init__(self, cell: surg_core.Cell, joints: Joints) -> None:
        self._cell, self._joints = cell, joints
        self._lock = threading.Lock()
        self._projection: MarkProjection | None = None
        self.withheld = ""
        self._topic = rospy.Publisher(TOPIC, PictureMarks, queue_size=1, tcp_nodelay=True)

    @property
    def wanted(self) -> bool:
        """Whether somebody listens to the topic."""
        return bool(self._topic.get_num_connections())

    def use(self, lenses: tuple[Lens, Lens] | None) -> None:
        """Project through these lenses; None: they are not known.

        Raises:
            ConfigError: As `MarkProjection`.
        """
        made = None if lenses is None else MarkProjection(self._cell, lenses)
        with self._lock:
            self._projection = made

    def at(self, stamp_ns: int) -> list[list[PictureMark]]:
        """Marks in each eye at a time.

        Raises:
            ValueError: No lens is known, nobody says where the endoscope was, or `withheld`.
        """
        if self.withheld:
            raise ValueError(self.withheld)
        with self._lock:
            projection = self._projection
        if projection is None:
            raise ValueError("the lenses are not known")
        scope, _ = self._joints.at(projection.held.arm, stamp_ns)
        if scope is None:
            raise ValueError(f"no joints of {projection.held.arm} at the pictures' time")
        marks: list[list[PictureMark]] = [[] for _ in projection.eyes]
        for arm in projection.arms:
            q, jaw = self._joints.at(arm, stamp_ns)
            if q is not None:  # a mark of an arm that is silent would lie
                for all_of, new in zip(marks, projection.marks(arm, q, jaw, scope), strict=True):
                    all_of.extend(new)
        return marks

    def tell(self, info: CameraInfo) -> None:
        """Publish the marks of a picture with this camera_info, if somebody listens."""
        if not self.wanted or info.header.stamp.is_zero():
            return
        try:
            found = self.at(info.header.stamp.to_nsec())
        except ValueError:  # the node's diagnostics tell why
            return
        self._topic.publish(message_of(info, found))


def message_of(info: CameraInfo, found: Sequence[Sequence[PictureMark]]) -> PictureMarks:
    """The message of marks in each eye, left first; numbers rounded to what a page can show."""
    message = PictureMarks(header=info.header, width=info.width, height=info.height)
    for eye, marks in zip(EYES, found, strict=False):
        for mark in marks:
            x, y = np.round(mark.pixels.T, 2).tolist()
            ellipse = np.round(mark.ellipse() or (), 4).tolist()
            message.marks.append(
                MarkMessage(arm=mark.arm, name=mark.name, eye=eye, x=x, y=y, ellipse=ellipse)
            )
    return message
