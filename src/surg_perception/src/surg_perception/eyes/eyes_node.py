"""The node ``/eyes``: rectified pictures, depth and points, and pictures with marks.

It works for what is subscribed only, takes the newest pair, at most ``~rate`` a second, on one
thread with a niceness, and moves nothing. Parameters: `eyes_parameters.EyesSettings`.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2

import surg_core
from surg_perception.depth.stereo_depth import StereoDepth
from surg_perception.depth.stereo_matcher import find_matcher
from surg_perception.eyes import eyes_messages_node as messages
from surg_perception.eyes import eyes_parameters
from surg_perception.eyes.eyes_parameters import EyesSettings
from surg_perception.eyes.joint_history import JointHistory
from surg_perception.marks.mark_drawing import drawn
from surg_perception.marks.mark_projection import MarkProjection
from surg_ros.params import ParamError

EYES = ("left", "right")
LOOK_S = 0.5
"""Period at which the node looks whether somebody subscribes."""


class NewestPair:
    """Subscribes to both eyes and keeps the newest pair of one stamp."""

    def __init__(self) -> None:
        self._newest: dict[str, Image] = {}
        self._pair: tuple[Image, Image] | None = None
        self._arrived = threading.Condition()
        self._subscribers: list[Any] = []

    def listen(self, wanted: bool) -> None:
        """Subscribe, or stop: nobody needs the pictures."""
        if wanted and not self._subscribers:
            self._subscribers = [
                rospy.Subscriber(
                    f"/endoscope/{eye}/image_raw",
                    Image,
                    self._on_image,
                    eye,
                    queue_size=1,
                    buff_size=1 << 25,
                    tcp_nodelay=True,
                )
                for eye in EYES
            ]
        elif not wanted and self._subscribers:
            for each in self._subscribers:
                each.unregister()
            self._subscribers = []

    def _on_image(self, message: Image, eye: str) -> None:
        with self._arrived:
            self._newest[eye] = message
            left, right = (self._newest.get(each) for each in EYES)
            if left is not None and right is not None and left.header.stamp == right.header.stamp:
                self._pair = (left, right)
                self._arrived.notify()

    def take(self, timeout: float) -> tuple[Image, Image] | None:
        """The newest pair, once; None: none arrives in time [s]."""
        with self._arrived:
            if self._pair is None:
                self._arrived.wait(timeout)
            pair, self._pair = self._pair, None
            return pair


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
            where = dict(zip(message.name, message.position, strict=False))
            known = wanted and set(wanted) <= set(where)
            q = [where[name] for name in wanted] if known else list(message.position)
            if q and len(q) == (len(wanted) or 1):
                with self._lock:
                    history.add(message.header.stamp.to_nsec(), np.array(q))

        return keep

    def at(self, arm: str, stamp_ns: int) -> tuple[np.ndarray | None, float]:
        """Joints (n,) [rad], None: not known, and jaw [rad], NaN: not known, at a time."""
        with self._lock:
            q, jaw = self._of[arm].at(stamp_ns), self._jaw[arm].at(stamp_ns)
        return q, float("nan") if jaw is None else float(jaw[0])


class Eyes:
    """Computes and publishes."""

    def __init__(self, settings: EyesSettings, cell: surg_core.Cell | None) -> None:
        self._settings, self._cell = settings, cell
        self._infos: dict[str, CameraInfo] = {}
        self._models: tuple[CameraInfo, ...] = ()
        self._depth: StereoDepth | None = None
        self._projection: MarkProjection | None = None
        self._problem, self._done, self._spent = "no pictures yet", 0, 0.0
        self._pairs = NewestPair()
        self._joints = Joints(cell) if settings.marks and cell is not None else None

        def topic(name: str, kind: type) -> rospy.Publisher:
            return rospy.Publisher(f"/endoscope/{name}", kind, queue_size=1, tcp_nodelay=True)

        self._rect, self._marked, self._of_depth = [], [], []
        if settings.depth:
            self._rect = [topic(f"{eye}/image_rect", Image) for eye in EYES]
            self._of_depth = [topic("depth", Image), topic("points2", PointCloud2)]
        if settings.marks:
            self._marked = [topic(f"{eye}/image_marks", Image) for eye in EYES]
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=2)
        self._info_subscribers = [
            rospy.Subscriber(f"/endoscope/{eye}/camera_info", CameraInfo, self._on_info, eye)
            for eye in EYES
        ]

    def _on_info(self, message: CameraInfo, eye: str) -> None:
        self._infos[eye] = message

    def run(self) -> None:
        """Work until shutdown."""
        period, told = 1.0 / self._settings.rate, 0.0
        next_at = 0.0
        while not rospy.is_shutdown():
            outputs = [*self._rect, *self._of_depth, *self._marked]
            wanted = any(each.get_num_connections() for each in outputs)
            self._pairs.listen(wanted)
            now = rospy.get_time()
            if now - told >= 1.0:
                self._report()
                told = now
            if not wanted or now < next_at:
                rospy.rostime.wallsleep(LOOK_S if not wanted else min(next_at - now, LOOK_S))
                continue
            pair = self._pairs.take(LOOK_S)
            if pair is None:
                continue
            next_at = max(next_at + period, rospy.get_time() + 0.5 * period)
            self._work(*pair)

    def _work(self, left: Image, right: Image) -> None:
        begun = rospy.get_time()
        try:
            self._prepare()
            self._look(left, right)
            self._done, problem = self._done + 1, ""
        except ValueError as error:  # ConfigError, MatcherError and unusable pictures are some
            problem = str(error)
        self._spent = rospy.get_time() - begun
        if problem and problem != self._problem:
            rospy.logwarn(f"eyes: {problem}")
        self._problem = problem

    def _prepare(self) -> None:
        """Renew what depends on the lenses when their models change."""
        infos = tuple(self._infos[eye] for eye in EYES if eye in self._infos)
        if len(infos) < 2:
            raise ValueError("no camera_info of both eyes; allowed: a stereo endoscope (--stereo)")
        if self._models and all(
            (a.K, a.D, a.R, a.P, a.width, a.height) == (b.K, b.D, b.R, b.P, b.width, b.height)
            for a, b in zip(infos, self._models, strict=True)
        ):
            return
        self._models = ()
        left, right = (
            messages.lens_of_message(f"endoscope_{eye}", info)
            for eye, info in zip(EYES, infos, strict=True)
        )
        settings = self._settings
        self._depth, self._R = None, left.R
        if settings.depth:
            self._depth = StereoDepth(
                left, right, None, settings.method, settings.near, settings.far
            )
        if settings.marks and self._cell is not None:
            self._projection = MarkProjection(self._cell, (left, right))
        self._models = infos

    def _look(self, left: Image, right: Image) -> None:
        pictures = [messages.picture_of(each) for each in (left, right)]
        headers = [left.header, right.header]
        outputs = [*self._rect, *self._of_depth]
        if self._depth is not None and any(each.get_num_connections() for each in outputs):
            if any(each.get_num_connections() for each in self._of_depth):
                found = self._depth.look(pictures[0], pictures[1])
                straight = (found.left, found.right)
                self._of_depth[0].publish(messages.depth_of(headers[0], found.depth))
                if self._of_depth[1].get_num_connections():
                    step = self._settings.step
                    points = self._depth.geometry.points(found.depth, step)
                    colours = found.left[::step, ::step]
                    cloud = messages.cloud_of(headers[0], points, colours, self._R)
                    self._of_depth[1].publish(cloud)
            else:
                straight = self._depth.rectifier.rectify(pictures[0], pictures[1])
            for publisher, header, picture in zip(self._rect, headers, straight, strict=True):
                if publisher.get_num_connections():
                    publisher.publish(messages.image_of(header, picture))
        if any(each.get_num_connections() for each in self._marked):
            self._mark(left.header.stamp.to_nsec(), headers, pictures)

    def _mark(self, stamp_ns: int, headers: list[Any], pictures: list[Any]) -> None:
        projection, joints = self._projection, self._joints
        if projection is None or joints is None:
            return
        scope, _ = joints.at(projection.held.arm, stamp_ns)
        if scope is None:
            raise ValueError(f"no joints of {projection.held.arm} at the pictures' time")
        marks: list[list[Any]] = [[], []]
        for arm in projection.arms:
            q, jaw = joints.at(arm, stamp_ns)
            if q is not None:  # a mark of an arm that is silent would lie
                for all_of, new in zip(marks, projection.marks(arm, q, jaw, scope), strict=True):
                    all_of.extend(new)
        for publisher, header, picture, each in zip(
            self._marked, headers, pictures, marks, strict=True
        ):
            if publisher.get_num_connections():
                publisher.publish(messages.image_of(header, drawn(picture, each)))

    def _report(self) -> None:
        array = DiagnosticArray()
        array.header.stamp = rospy.Time.now()
        level = DiagnosticStatus.WARN if self._problem else DiagnosticStatus.OK
        values = {"pairs": self._done, "last pair [ms]": round(1e3 * self._spent, 1)}
        array.status.append(
            DiagnosticStatus(
                level=level,
                name="eyes",
                message=self._problem or "ok",
                values=[KeyValue(key, str(value)) for key, value in values.items()],
            )
        )
        self._diagnostics.publish(array)


def main() -> int:
    """Entry point; returns the exit code (0 done, 2 broken configuration)."""
    rospy.init_node("eyes")
    try:
        settings = eyes_parameters.parse(rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell) if settings.cell else None
        _check_method(settings)
    except (ParamError, ValueError) as error:
        print(f"surg_perception: {error}", file=sys.stderr, flush=True)
        return 2
    os.nice(settings.niceness)
    cv2.setNumThreads(1)
    Eyes(settings, cell).run()
    return 0


def _check_method(settings: EyesSettings) -> None:
    """Refuse a method at the start, not with the first pair."""
    from surg_perception.depth.rectification import PairGeometry

    geometry = PairGeometry((640, 480), 450.0, 450.0, 319.5, 239.5, 0.0, 0.004)
    find_matcher(settings.method, geometry, settings.near, settings.far)


if __name__ == "__main__":
    sys.exit(main())
