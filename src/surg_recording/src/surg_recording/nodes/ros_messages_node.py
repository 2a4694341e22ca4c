"""The frames of an export as ROS messages, in the order of their time.

Topics are those of the arms (CRTK, as on dVRK) and of the cameras. A pose in the rcm frame has the
frame id ``<arm>_rcm``, one in the base frame ``<arm>_base``.
"""

from __future__ import annotations

import heapq
import io
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import genpy
import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3, WrenchStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from std_msgs.msg import Header, String

from surg_core.action_space import ABSOLUTE
from surg_core.contract import ACTION_KEY, FORCE_KEY, STATE_KEY
from surg_core.force.observed_force import TOPICS
from surg_core.transforms import tip_quaternion
from surg_recording.calibration.endoscope_record import MODEL_KEYS
from surg_recording.datasets import pictures, schema
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

JPEG_QUALITY = 95
_NEEDED = (STATE_KEY, ACTION_KEY, "observation.cartesian_state", "observation.joint_positions")


class Stamped(NamedTuple):
    """A message with its topic and time."""

    time_ns: int
    topic: str
    message: Any


def serialised(message: Any) -> bytes:
    """The bytes of a ROS message, as they are on the wire."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def messages(sampled: Sampled, options: ExportOptions) -> Iterator[Stamped]:
    """All messages of a recording; an EpisodeError if a feature that they need is left out."""
    jointed = any(sampled.candidate.layout.joints)  # recordings of other programs may have none
    needed = _NEEDED if jointed else _NEEDED[:-1]
    missing = [name for name in needed if name not in sampled.columns]
    if missing or options.action_space != ABSOLUTE:
        what = f"--drop {' '.join(missing)}" if missing else f"--action-space {ABSOLUTE} only"
        raise EpisodeError(f"messages need {', '.join(needed)}: {what}")
    streams = [_texts(sampled)]
    for arm in sampled.candidate.layout.arms:
        if jointed:
            streams.append(_joints(sampled, arm))
        if arm in sampled.candidate.layout.commanded:
            streams += [_motion(sampled, arm), _commands(sampled, arm)]
            if FORCE_KEY in sampled.columns:
                streams.append(_forces(sampled, arm))
    for feature in schema.videos_of(sampled.features):
        streams.append(_pictures(sampled, feature, options))
        streams.append(_lenses(sampled, feature))
    if schema.CAMERA_POSE in sampled.columns:
        streams.append(_camera_poses(sampled))
    yield from heapq.merge(*streams, key=lambda stamped: stamped.time_ns)


def topics_of(camera: str) -> str:
    """Root of a camera's topics: ``endoscope_left`` is ``/endoscope/left``."""
    stem, _, side = camera.rpartition("_")
    return f"/{stem}/{side}" if stem and side in ("left", "right") else f"/{camera}"


def _texts(sampled: Sampled) -> Iterator[Stamped]:
    """The instruction at the start, and every stage when it begins."""
    times = sampled.grid.times_ns
    for name, topic in ((schema.INSTRUCTION, "/instruction"), (schema.STAGE, "/stage")):
        before = None
        for time_ns, text in zip(times, sampled.columns.get(name, ()), strict=False):
            if text != before:
                yield Stamped(int(time_ns), topic, String(str(text)))
            before = text


def _columns(sampled: Sampled, feature: str, arm: str) -> dict[str, npt.NDArray[Any]]:
    """The columns of an arm in a feature, by their name without the arm."""
    names = next(f.names for f in sampled.features if f.name == feature)
    values = sampled.columns[feature].astype(np.float64).reshape(sampled.grid.frames, -1)
    prefix = f"{arm}/"
    return {n[len(prefix) :]: values[:, i] for i, n in enumerate(names) if n.startswith(prefix)}


def _joints(sampled: Sampled, arm: str) -> Iterator[Stamped]:
    q = _columns(sampled, "observation.joint_positions", arm)
    qd = _columns(sampled, "observation.joint_velocities", arm)
    for k, time_ns in enumerate(map(int, sampled.grid.times_ns)):
        state = JointState(header=_header(time_ns, f"{arm}_base"), name=list(q))
        state.position = [values[k] for values in q.values()]
        state.velocity = [values[k] for values in qd.values()]
        yield Stamped(time_ns, f"/{arm}/measured_js", state)


def _motion(sampled: Sampled, arm: str) -> Iterator[Stamped]:
    """Measured pose and jaw, the set-point, and the drive of a wrist as in a graph."""
    pose = _columns(sampled, "observation.cartesian_state", arm)
    state = _columns(sampled, STATE_KEY, arm)
    for k, time_ns in enumerate(map(int, sampled.grid.times_ns)):
        p, q = ([pose[name][k] for name in names] for names in (schema.POSE[:3], schema.POSE[3:]))
        yield Stamped(time_ns, f"/{arm}/measured_cp", _pose(time_ns, f"{arm}_base", p, q))
        p_set = [state[f"set_{axis}"][k] for axis in "xyz"]
        q_set = _orientation(state, k, "set_q", p_set, "roll_set")
        yield Stamped(time_ns, f"/{arm}/setpoint_cp", _pose(time_ns, f"{arm}_rcm", p_set, q_set))
        jaw = _jaw(time_ns, state["jaw"][k])
        yield Stamped(time_ns, f"/{arm}/jaw/measured_js", jaw)
        if "wrist_pitch" in state:
            tool = JointState(header=_header(time_ns, ""), name=["pitch", "yaw", "jaw"])
            tool.position = [state[name][k] for name in ("wrist_pitch", "wrist_yaw", "jaw")]
            yield Stamped(time_ns, f"/{arm}/tool/measured_js", tool)


def _orientation(values: dict[str, npt.NDArray[Any]], k: int, q: str, p: Any, roll: str) -> Any:
    """Of a tool, x, y, z, w: as stated (columns such as ``qx``), or of a straight one at p."""
    if f"{q}x" in values:
        return [values[f"{q}{axis}"][k] for axis in "xyzw"]
    return tip_quaternion(p, values[roll][k])


def _forces(sampled: Sampled, arm: str) -> Iterator[Stamped]:
    """The force at each place where a sensor knows it."""
    felt = _columns(sampled, FORCE_KEY, arm)
    for k, time_ns in enumerate(map(int, sampled.grid.times_ns)):
        for place, topic in TOPICS.items():
            if felt[f"{place}_known"][k]:
                message = WrenchStamped(header=_header(time_ns, f"{arm}_rcm"))
                message.wrench.force = Vector3(*(felt[f"{place}_{axis}"][k] for axis in "xyz"))
                yield Stamped(time_ns, f"/{arm}/{topic}", message)


def _commands(sampled: Sampled, arm: str) -> Iterator[Stamped]:
    """The command in force at the next grid time, with that time."""
    action = _columns(sampled, ACTION_KEY, arm)
    for k, time_ns in enumerate(map(int, sampled.grid.next_ns)):
        p = [action[axis][k] for axis in "xyz"]
        pose = _pose(time_ns, f"{arm}_rcm", p, _orientation(action, k, "q", p, "roll"))
        yield Stamped(time_ns, f"/{arm}/servo_cp", pose)
        yield Stamped(time_ns, f"/{arm}/jaw/servo_jp", _jaw(time_ns, action["jaw"][k]))


def _pictures(sampled: Sampled, feature: Feature, options: ExportOptions) -> Iterator[Stamped]:
    """JPEG pictures: the time of the frame, in the header the picture's own stamp."""
    topic = f"{topics_of(feature.camera)}/image_raw/compressed"
    stamps = sampled.columns[f"timing.{feature.camera}.stamp_ns"]
    frames = sampled.frames(feature.name)
    for time_ns, stamp, frame in zip(sampled.grid.times_ns, stamps, frames, strict=True):
        image = pictures.rgb(frame, options.size)
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        _, coded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), quality)
        header = _header(int(stamp), feature.camera)
        message = CompressedImage(header=header, format="jpeg", data=coded.tobytes())
        yield Stamped(int(time_ns), topic, message)


def _lenses(sampled: Sampled, feature: Feature) -> Iterator[Stamped]:
    """The model of the camera beside each picture, with the same header; none if not recorded."""
    model = sampled.candidate.about["calibration"]["camera_info"].get(feature.camera)
    if model is None:
        return
    topic = f"{topics_of(feature.camera)}/camera_info"
    stated = {key: model[key] for key in MODEL_KEYS}
    stamps = sampled.columns[f"timing.{feature.camera}.stamp_ns"]
    for time_ns, stamp in zip(sampled.grid.times_ns, stamps, strict=True):
        info = CameraInfo(header=_header(int(stamp), feature.camera), **stated)
        yield Stamped(int(time_ns), topic, info)


def _camera_poses(sampled: Sampled) -> Iterator[Stamped]:
    """The pose of the left camera in the world."""
    poses = sampled.columns[schema.CAMERA_POSE].astype(np.float64)
    for time_ns, pose in zip(map(int, sampled.grid.times_ns), poses, strict=True):
        yield Stamped(time_ns, "/endoscope/left/pose", _pose(time_ns, "world", pose[:3], pose[3:]))


def _header(time_ns: int, frame: str) -> Header:
    return Header(stamp=ros_time(time_ns), frame_id=frame)


def ros_time(time_ns: int) -> genpy.Time:
    """A time of ROS."""
    return genpy.Time(*divmod(time_ns, 1_000_000_000))


def _pose(time_ns: int, frame: str, p: Any, q: Any) -> PoseStamped:
    pose = Pose(Point(*map(float, p)), Quaternion(*map(float, q)))
    return PoseStamped(header=_header(time_ns, frame), pose=pose)


def _jaw(time_ns: int, angle: float) -> JointState:
    return JointState(header=_header(time_ns, ""), name=["jaw"], position=[float(angle)])
