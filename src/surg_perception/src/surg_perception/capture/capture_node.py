"""The node ``/endoscope`` of a real cell: the topics of the simulator's endoscope.

Each device has a process (`device_process`) and a thread here that publishes what it delivers. No
signal means no pictures: nothing on the topics, the reason on /diagnostics and in the log.
Parameters: `capture_parameters.CaptureSettings`.
"""

from __future__ import annotations

import functools
import sys
import threading

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

import surg_core
from surg_core import ConfigError
from surg_core.lens_file import Lens
from surg_perception.capture import eye_lenses, frame_pipe
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.device_reader import DeviceReader
from surg_perception.capture.eye_layout import Image as Picture
from surg_perception.capture.eye_layout import eyes_of
from surg_perception.capture.eye_pairing import EyePairer
from surg_perception.capture.frame_pipe import DeviceState, Pictures
from surg_perception.capture.picture_source import SourceUri
from surg_ros.endoscope_tf import EndoscopeTf
from surg_ros.params import ParamError, read

QUEUE = 4
"""Pictures that wait for a slow subscriber."""
REPORT_S = 10.0
"""Period of the reports on pairs of two devices."""


def camera_info(eye: str, lens: Lens | None, width: int, height: int) -> CameraInfo:
    """The camera's model; K is 0 where no lens was measured, as ROS has it."""
    info = CameraInfo(width=width, height=height)
    info.header.frame_id = eye_lenses.FRAMES[eye]
    if lens is not None:
        info.distortion_model = lens.distortion_model
        info.D, info.K = lens.D.tolist(), lens.K.ravel().tolist()
        info.R, info.P = lens.R.ravel().tolist(), lens.P.ravel().tolist()
    return info


class EyeTopics:
    """The topics of one eye."""

    def __init__(self, eye: str, lens: Lens | None) -> None:
        self._eye, self._lens = eye, lens
        self._info: CameraInfo | None = None
        root = self._root = f"/endoscope/{eye}"
        self._image = rospy.Publisher(
            f"{root}/image_raw", Image, queue_size=QUEUE, tcp_nodelay=True
        )
        self._compressed: rospy.Publisher | None = None  # a topic that stays silent is none
        self._camera_info = rospy.Publisher(
            f"{root}/camera_info", CameraInfo, queue_size=QUEUE, latch=True
        )

    def publish(self, picture: Picture, jpeg: bytes, stamp: rospy.Time) -> str:
        """Publish a picture; returns what is wrong with the lens file, empty: nothing."""
        height, width, _ = picture.shape
        problem = ""
        if self._info is None or (self._info.width, self._info.height) != (width, height):
            lens, problem = eye_lenses.fitted(self._lens, width, height)
            self._info = camera_info(self._eye, lens, width, height)
        self._info.header.stamp = stamp
        image = Image(height=height, width=width, encoding="rgb8", step=3 * width)
        image.header, image.data = self._info.header, picture.tobytes()
        self._image.publish(image)
        if jpeg:
            coded = CompressedImage(format="jpeg", data=jpeg)
            coded.header = self._info.header
            if self._compressed is None:
                name = f"{self._root}/image_raw/compressed"
                self._compressed = rospy.Publisher(
                    name, CompressedImage, queue_size=QUEUE, tcp_nodelay=True
                )
            self._compressed.publish(coded)
        self._camera_info.publish(self._info)
        return problem


class Capture:
    """Publishes what the devices deliver."""

    def __init__(self, settings: CaptureSettings) -> None:
        self._settings = settings
        self._eyes = eyes_of(settings.layout)
        self._problem = ""
        try:
            lenses = eye_lenses.load(settings.calibration, self._eyes)
        except ConfigError as error:
            lenses = {}
            self._lens_problem(str(error))
        self._topics = {eye: EyeTopics(eye, lenses.get(eye)) for eye in self._eyes}
        self._lock = threading.Lock()
        self._published, self._said_published, self._offset = 0, 0, ""
        devices = settings.devices()
        period = round(1e9 / settings.rate) if settings.rate else 0
        self._pairer = EyePairer(period) if len(devices) == 2 else None
        self._states = [DeviceState("opening", f"{d.source}: opening") for d in devices]
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        live = SourceUri.parse(settings.source).source().live
        self._readers = [
            DeviceReader(device, functools.partial(self._take, n), live)
            for n, device in enumerate(devices)
        ]

    def _lens_problem(self, text: str) -> None:
        self._problem = f"camera_info is empty: {text}"
        rospy.logerr(f"endoscope: {self._problem}")

    def _take(self, device: int, message: Pictures | DeviceState) -> None:
        with self._lock:
            if isinstance(message, DeviceState):
                self._states[device] = message
                log = rospy.loginfo if message.code == frame_pipe.OPEN else rospy.logwarn
                log(f"endoscope: {message.text}")
            elif self._pairer is None:
                self._publish(message.eyes, message.jpegs, message.stamp_ns)
            else:
                pair = self._pairer.add(device, message.stamp_ns, message)
                if pair is not None:
                    eyes = (pair.left.eyes[0], pair.right.eyes[0])
                    self._publish(eyes, pair.left.jpegs + pair.right.jpegs, pair.stamp_ns)

    def _publish(self, eyes: tuple[Picture, ...], jpegs: tuple[bytes, ...], stamp_ns: int) -> None:
        stamp = rospy.Time(*divmod(stamp_ns, 1_000_000_000))
        coded = jpegs if len(jpegs) == len(eyes) else (b"",) * len(eyes)
        for eye, picture, jpeg in zip(self._eyes, eyes, coded, strict=True):
            if problem := self._topics[eye].publish(picture, jpeg, stamp):
                self._lens_problem(problem)
        self._published += 1

    def run(self) -> None:
        """Report on /diagnostics once a second until shutdown."""
        rate, seconds = rospy.Rate(1.0), 0
        while not rospy.is_shutdown():
            seconds += 1
            if self._pairer is not None and seconds % round(REPORT_S) == 0:
                with self._lock:
                    report = self._pairer.report()
                self._offset = (
                    f"right - left {report.offset_ns * 1e-6:.1f} ms, spread "
                    f"{report.spread_ns * 1e-6:.1f} ms"
                )
                rospy.loginfo(f"endoscope: {report.pairs} pairs; {self._offset}")
                self._unpaired(report.problem)
            self._report()
            try:
                rate.sleep()
            except rospy.ROSInterruptException:
                break
        for reader in self._readers:
            reader.close()

    def _unpaired(self, problem: str) -> None:
        self._problem = problem or ("" if "synchronised" in self._problem else self._problem)
        if problem:
            rospy.logwarn(f"endoscope: {problem}")

    def _report(self) -> None:
        array = DiagnosticArray()
        array.header.stamp = rospy.Time.now()
        with self._lock:
            rate, self._said_published = self._published - self._said_published, self._published
            for state in self._states:
                good = state.code == frame_pipe.OPEN
                level = DiagnosticStatus.OK if good else DiagnosticStatus.ERROR
                message = state.text if good else f"{state.code}: {state.text}"
                if good and self._problem:
                    level, message = DiagnosticStatus.WARN, self._problem
                values = {
                    "published per s": rate,
                    "published": self._published,
                    "latency subtracted [s]": self._settings.latency,
                    "pairs": self._offset,
                }
                array.status.append(
                    DiagnosticStatus(
                        level=level,
                        name="endoscope",
                        message=message,
                        hardware_id=self._settings.source,
                        values=[KeyValue(key, str(value)) for key, value in values.items()],
                    )
                )
        self._diagnostics.publish(array)


def main() -> int:
    """Entry point; returns the exit code (0 done, 2 broken configuration)."""
    rospy.init_node("endoscope")
    try:
        settings = read(CaptureSettings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell) if settings.cell else None
    except (ParamError, surg_core.ConfigError) as error:
        print(f"surg_perception: {error}", file=sys.stderr, flush=True)
        return 2
    frames = EndoscopeTf(cell) if cell else None
    Capture(settings).run()
    del frames
    return 0


if __name__ == "__main__":
    sys.exit(main())
