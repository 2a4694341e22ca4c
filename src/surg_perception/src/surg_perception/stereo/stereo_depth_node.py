"""The node ``/eyes``: rectified pictures, depth and points, marks, and whether anything moved.

It works for what is subscribed only, takes the newest pair, at most ``~rate`` a second, on one
thread with a niceness, and moves nothing. Marks need no pixels and come with every picture. The
watch for drift (`live_drift_node`) looks at every pair.
Parameters: `stereo_parameters.StereoSettings`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import cv2
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

import surg_core
from surg_core.host.niceness import give_way
from surg_perception.depth.stereo_depth import StereoDepth
from surg_perception.depth.stereo_matcher import find_matcher
from surg_perception.stereo import stereo_messages_node as messages
from surg_perception.stereo.live_drift_node import LiveDrift
from surg_perception.stereo.live_marks_node import Joints, LiveMarks
from surg_perception.stereo.newest_pair_node import EYES, NewestPair
from surg_perception.stereo.stereo_parameters import StereoSettings
from surg_ros.params import ParamError, read

LOOK_S = 0.5
"""Period at which the node looks whether somebody subscribes."""


class Eyes:
    """Computes and publishes."""

    def __init__(self, settings: StereoSettings, cell: surg_core.Cell | None) -> None:
        self._settings = settings
        self._infos: dict[str, CameraInfo] = {}
        self._models: tuple[CameraInfo, ...] = ()
        self._depth: StereoDepth | None = None
        self._problem, self._done, self._spent = "no pictures yet", 0, 0.0
        self._pairs = NewestPair()
        self._marks: LiveMarks | None = None
        self._drift: LiveDrift | None = None
        if cell is not None and (settings.marks or settings.drift):
            joints = Joints(cell)
            self._marks = LiveMarks(cell, joints) if settings.marks else None
            self._drift = LiveDrift(cell, joints) if settings.drift else None

        def topic(name: str, kind: type) -> rospy.Publisher:
            return rospy.Publisher(f"/endoscope/{name}", kind, queue_size=1, tcp_nodelay=True)

        self._rect, self._of_depth = [], []
        if settings.depth:
            self._rect = [topic(f"{eye}/image_rect", Image) for eye in EYES]
            self._of_depth = [topic("depth", Image), topic("points2", PointCloud2)]
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=2)
        self._info_subscribers = [
            rospy.Subscriber(
                f"/endoscope/{eye}/camera_info", CameraInfo, self._on_info, eye, tcp_nodelay=True
            )
            for eye in EYES
        ]

    def _on_info(self, message: CameraInfo, eye: str) -> None:
        self._infos[eye] = message
        if self._marks is not None and eye == EYES[0]:
            self._marks.tell(message)

    def run(self) -> None:
        """Work until shutdown."""
        period, told = 1.0 / self._settings.rate, 0.0
        next_at = 0.0
        while not rospy.is_shutdown():
            wanted = self._drift is not None or self._depth_wanted
            self._pairs.listen(wanted)
            now = rospy.get_time()
            if now - told >= 1.0:
                self._report()
                told = now
            if not wanted and self._marks is not None and self._marks.wanted:
                self._attempt(self._prepare)
            if not wanted or now < next_at:
                rospy.rostime.wallsleep(LOOK_S if not wanted else min(next_at - now, LOOK_S))
                continue
            pair = self._pairs.take(LOOK_S)
            if pair is None:
                if self._drift is not None:
                    self._drift.idle()
                continue
            next_at = max(next_at + period, rospy.get_time() + 0.5 * period)
            begun = rospy.get_time()
            self._attempt(self._look, *pair)
            self._spent = rospy.get_time() - begun

    @property
    def _depth_wanted(self) -> bool:
        """Whether somebody listens to what is made of pixels."""
        return any(each.get_num_connections() for each in (*self._rect, *self._of_depth))

    def _attempt(self, step: Callable[..., None], *inputs: Image) -> None:
        """Do it; what cannot be used becomes the node's problem."""
        problem = ""
        try:
            step(*inputs)
        except ValueError as error:  # ConfigError, MatcherError and unusable pictures are some
            problem = str(error)
        if problem and problem != self._problem:
            rospy.logwarn(f"eyes: {problem}")
        if problem and self._drift is not None:
            self._drift.blind(problem)
        self._problem = problem

    def _prepare(self) -> None:
        """Renew what depends on the lenses when their models change."""
        infos = tuple(self._infos[eye] for eye in EYES if eye in self._infos)
        if len(infos) < 2:
            raise ValueError(
                "no camera_info of both eyes; allowed: a stereo endoscope (--cameras stereo)"
            )
        if self._models and all(
            (a.K, a.D, a.R, a.P, a.width, a.height) == (b.K, b.D, b.R, b.P, b.width, b.height)
            for a, b in zip(infos, self._models, strict=True)
        ):
            return
        self._models = ()
        views = [each for each in (self._marks, self._drift) if each is not None]
        for view in views:
            view.use(None)
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
        for view in views:
            view.use((left, right))
        self._models = infos

    def _look(self, left: Image, right: Image) -> None:
        self._prepare()
        pictures = [messages.picture_of(each) for each in (left, right)]
        headers = [left.header, right.header]
        if self._drift is not None:
            self._drift.look((pictures[0], pictures[1]), left.header.stamp.to_nsec())
            if self._marks is not None:
                self._marks.withheld = self._drift.refusal
        if self._depth is not None and self._depth_wanted:
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
        self._done += 1

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
        settings = read(StereoSettings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell) if settings.cell else None
        _check_method(settings)
        eyes = Eyes(settings, cell)
    except (ParamError, ValueError) as error:
        print(f"surg_perception: {error}", file=sys.stderr, flush=True)
        return 2
    give_way(settings.niceness)
    cv2.setNumThreads(1)
    eyes.run()
    return 0


def _check_method(settings: StereoSettings) -> None:
    """Refuse a method at the start, not with the first pair."""
    from surg_perception.depth.rectification import PairGeometry

    geometry = PairGeometry((640, 480), 450.0, 450.0, 319.5, 239.5, 0.0, 0.004)
    find_matcher(settings.method, geometry, settings.near, settings.far)


if __name__ == "__main__":
    sys.exit(main())
