"""Imports a bag of ROS 1 or ROS 2, such as one of dVRK, as an episode folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.transforms import quaternion_xyzw_to_matrix, rpy_to_matrix, twist_angle
from surg_recording.clock.stream_skew import nearest_ns
from surg_recording.imports import bag_map
from surg_recording.imports.arm_series import ArmSeries, write
from surg_recording.imports.bag_file import BagFile
from surg_recording.imports.bag_map import ArmTopics, BagMap
from surg_recording.imports.bag_streams import BagStreams, Samples, Values
from surg_recording.imports.ledger import Ledger
from surg_recording.recording_errors import EpisodeError, words_of

Array = npt.NDArray[np.float64]

APART_NS = 200_000_000
"""A pose whose nearest joint state is further away than this, and than three of its periods, is
left out [ns]."""
UNIT_TOLERANCE = 0.01
"""By which a quaternion's length may differ from 1."""


def import_bag(
    path: Path,
    folder: Path,
    chosen: BagMap | None = None,
    ledger: Ledger | None = None,
    own_stamps: bool = True,
) -> Path:
    """Write a bag as an episode folder; without a map by dVRK's names.

    Args:
        path: Of the bag; a folder in ROS 2.
        folder: The new folder.
        chosen: Which topic is what.
        ledger: Receives what was kept and dropped.
        own_stamps: False: the times at which the bag received the messages count.

    Raises:
        EpisodeError: It is no bag, lacks a topic, a message is not of a usable type, the stamps
            contradict one another, or more would be lost than the ledger allows.
    """
    ledger = Ledger() if ledger is None else ledger
    try:
        with BagFile(path) as bag:
            kinds = bag.kinds
            chosen = chosen or bag_map.of_dvrk(kinds)
            wanted = {t for arm in chosen.arms for t in arm.topics.values()}
            missing = sorted((wanted | set(chosen.cameras.values())) - set(kinds))
            if missing:
                there = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))
                raise EpisodeError(f"no topic {', '.join(missing)}; there are {there}")
            streams = BagStreams(bag, ledger, own_stamps)
            arms = [_series(streams, arm) for arm in chosen.arms]
            pictures = streams.pictures(chosen.cameras)
            ledger.check()
            left = sorted(set(kinds) - wanted - set(chosen.cameras.values()))
            if left:
                ledger.assume(f"topics that are not imported: {', '.join(left)}")
            facts = dict(chosen.facts)
            run = {"robot": arms[0].robot, "setting": facts.get("setting"), **facts}
            source = {"format": "rosbag2" if bag.ros2 else "rosbag", "from": str(path)}
            manifest = {**facts, "run": run, "imported": source, "clock": "bag"}
            manifest.setdefault("task", path.stem)
            return write(folder, arms, list(chosen.cameras), pictures, manifest, ledger)
    except EpisodeError as problem:
        raise EpisodeError(words_of(problem, path)) from None


def _series(streams: BagStreams, arm: ArmTopics) -> ArmSeries:
    topic, ledger = arm.topics["measured_cp"], streams.ledger
    poses = _oriented(streams.samples(topic, _Poses(topic)), topic, ledger)
    joints = _Joints()
    of_key: Mapping[str, Values] = {"measured_js": joints, "jaw": _jaw, "goal_jaw": _jaw}
    found = {
        key: streams.samples(arm.topics[key], values)
        for key, values in of_key.items()
        if key in arm.topics
    }
    good = np.ones(len(poses.stamps), bool)
    for key in {"measured_js", "jaw"} & set(found):
        away = _far(found[key], poses.stamps)
        reason = f"without a message of {arm.topics[key]} beside them"
        good = ledger.sieve(topic, away, reason, good)
    poses = poses.only(good)
    times, R_RB = poses.stamps, rpy_to_matrix(arm.rcm_rpy).T
    zeros = np.zeros(len(times))
    jaw = found["jaw"].at(times)[:, 0] if "jaw" in found else zeros
    goal = poses.values
    if "goal_cp" in arm.topics:
        goal = _goal(streams, arm.topics["goal_cp"], poses)
    q, qd = np.zeros((len(times), 0)), np.zeros((len(times), 0))
    if "measured_js" in found:
        q, qd = np.split(found["measured_js"].at(times), [joints.count], axis=1)
        if q.shape != qd.shape:
            ledger.assume(f"{arm.topics['measured_js']}: velocities are differences of positions")
            qd = np.gradient(q, (times - times[0]) * 1e-9, axis=0) if len(times) > 1 else 0.0 * q
    return ArmSeries(
        name=arm.name,
        stamps=times,
        p_BTip=poses.values[:, :3],
        roll=_roll(R_RB, poses.values),
        jaw=jaw,
        q=q,
        qd=qd,
        p_BGoal=goal[:, :3],
        roll_goal=_roll(R_RB, goal),
        jaw_goal=found["goal_jaw"].at(times)[:, 0] if "goal_jaw" in found else jaw,
        p_BRcm=np.array(arm.rcm),
        rpy_BR=np.array(arm.rcm_rpy),
        robot=arm.robot,
        instrument=arm.instrument,
    )


def _oriented(poses: Samples, topic: str, ledger: Ledger) -> Samples:
    """Poses whose quaternion is one."""
    length = np.linalg.norm(poses.values[:, 3:], axis=1)
    good = np.ones(len(length), bool)
    good = ledger.sieve(topic, length == 0, "without an orientation (quaternion 0 0 0 0)", good)
    off = np.abs(length - 1) > UNIT_TOLERANCE
    good = ledger.sieve(topic, off, "with a quaternion that is not of length 1", good)
    ledger.check()
    return poses.only(good)


def _far(samples: Samples, times: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Times without a sample beside them."""
    known = samples.stamps
    if not len(known):
        return np.ones(len(times), bool)
    period = int(np.median(np.diff(known))) if len(known) > 1 else 0
    return np.asarray(nearest_ns(times, known) > max(APART_NS, 3 * period))


def _goal(streams: BagStreams, topic: str, poses: Samples) -> Array:
    """The commanded poses at the measured ones; before the first command the measured ones."""
    goals = _oriented(streams.samples(topic, _Poses(topic)), topic, streams.ledger)
    if not len(goals.stamps):
        return poses.values
    newest = np.searchsorted(goals.stamps, poses.stamps, side="right") - 1
    turned = goals.values[newest.clip(0), 3:]  # orientations: the newest
    values = np.hstack([goals.at(poses.stamps)[:, :3], turned])
    early = int((newest < 0).sum())
    if early:
        streams.ledger.assume(f"{topic}: {early} poses before the first command count as goals")
    return np.where(newest[:, None] < 0, poses.values, values)


def _roll(R_RB: Array, pose: Array) -> Array:
    """Twist of the tool about the rcm frame's z, continuous [rad]."""
    twists = []
    for quaternion in pose[:, 3:]:
        twist, _ = twist_angle(R_RB @ quaternion_xyzw_to_matrix(quaternion))
        twists.append(float(twist))
    return np.unwrap(twists)


class _Poses:
    """x, y, z and quaternion of a pose or a transform, stamped or not, all of one body."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._frames: tuple[str, str] | None = None

    def __call__(self, message: Any) -> list[float]:
        frame = getattr(getattr(message, "header", None), "frame_id", "")
        if frame:
            self._check((str(frame), str(getattr(message, "child_frame_id", ""))))
        if hasattr(message, "transform"):
            p, q = message.transform.translation, message.transform.rotation
        else:
            pose = getattr(message, "pose", message)
            pose = getattr(pose, "pose", pose)  # that of a PoseWithCovariance
            p, q = pose.position, pose.orientation
        return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]

    def _check(self, frames: tuple[str, str]) -> None:
        self._frames = self._frames or frames
        if frames != self._frames:
            first, then = (" to ".join(filter(None, each)) for each in (self._frames, frames))
            raise EpisodeError(
                f"{self._topic}: its frames are {first} first, then {then}; allowed: the same in"
                " all messages. Write each pair to a topic of its own"
            )


class _Joints:
    """Positions, then velocities (none in some bags), of a JointState."""

    count = 0
    """Joints of the first message."""
    _names: tuple[str, ...] | None = None

    def __call__(self, message: Any) -> list[float]:
        """Nothing of a message whose joints are others than those of the first."""
        names = tuple(map(str, message.name))
        self._names = names if self._names is None else self._names
        if set(names) != set(self._names):
            return []
        self.count = self.count or len(message.position)
        numbers = [*message.position, *message.velocity]
        if names == self._names or len(numbers) % len(names):
            return numbers
        order = [names.index(name) for name in self._names]
        return [numbers[at + k] for at in range(0, len(numbers), len(names)) for k in order]


def _jaw(message: Any) -> list[float]:
    return list(message.position)[:1]
