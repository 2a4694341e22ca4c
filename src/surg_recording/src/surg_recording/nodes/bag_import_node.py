"""Imports a bag of ROS 1, such as one of dVRK, as an episode folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rosbag

from surg_core.transforms import quaternion_xyzw_to_matrix, rpy_to_matrix, twist_angle
from surg_recording.imports import bag_map
from surg_recording.imports.arm_series import ArmSeries, Picture, write
from surg_recording.imports.bag_map import ArmTopics, BagMap
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]
Samples = tuple[npt.NDArray[np.int64], Array]
"""Stamps (N,) [ns] and values (N, D)."""


def import_bag(path: Path, folder: Path, chosen: BagMap | None = None) -> Path:
    """Write a bag as an episode folder; without a map by dVRK's names.

    Raises:
        EpisodeError: It is no bag, lacks a topic, or a message is not of a usable type.
    """
    try:
        with rosbag.Bag(str(path)) as bag:
            stated = bag.get_type_and_topic_info().topics
            kinds = {topic: str(about.msg_type) for topic, about in stated.items()}
            chosen = chosen or bag_map.of_dvrk(kinds)
            wanted = {t for arm in chosen.arms for t in arm.topics.values()}
            missing = sorted((wanted | set(chosen.cameras.values())) - set(kinds))
            if missing:
                raise EpisodeError(f"no topic {', '.join(missing)}; there are {_list(kinds)}")
            arms = [_series(bag, arm) for arm in chosen.arms]
            facts = dict(chosen.facts)
            run = {"robot": arms[0].robot, "setting": facts.get("setting"), **facts}
            source = {"format": "rosbag", "from": str(path)}
            manifest = {**facts, "run": run, "imported": source, "clock": "bag"}
            manifest.setdefault("task", path.stem)
            pictures = _pictures(bag, chosen)
            return write(folder, arms, list(chosen.cameras), pictures, manifest)
    except (rosbag.ROSBagException, OSError) as problem:
        raise EpisodeError(f"{path}: not a bag that can be read ({problem})") from None
    except EpisodeError as problem:
        raise EpisodeError(f"{path}: {problem}") from None


def _list(kinds: dict[str, str]) -> str:
    return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))


def _series(bag: rosbag.Bag, arm: ArmTopics) -> ArmSeries:
    stamps, pose = _samples(bag, arm.topics["measured_cp"], _pose)
    R_RB = rpy_to_matrix(arm.rcm_rpy).T
    joints = _resampled(bag, arm, "measured_js", _joints, stamps)
    q, qd = np.split(joints, 2, axis=1)
    jaw = _resampled(bag, arm, "jaw", _jaw, stamps)[:, :1]
    roll = _roll(R_RB, pose)
    goal = pose
    if "goal_cp" in arm.topics:
        goal = _resampled(bag, arm, "goal_cp", _pose, stamps)
    goal_jaw = _resampled(bag, arm, "goal_jaw", _jaw, stamps)[:, :1]
    return ArmSeries(
        name=arm.name,
        stamps=stamps,
        p_BTip=pose[:, :3],
        roll=roll,
        jaw=jaw[:, 0] if jaw.size else np.zeros(len(stamps)),
        q=q,
        qd=qd,
        p_BGoal=goal[:, :3],
        roll_goal=_roll(R_RB, goal),
        jaw_goal=(goal_jaw if goal_jaw.size else jaw)[:, 0]
        if goal_jaw.size or jaw.size
        else np.zeros(len(stamps)),
        p_BRcm=np.array(arm.rcm),
        rpy_BR=np.array(arm.rcm_rpy),
        robot=arm.robot,
        instrument=arm.instrument,
    )


def _roll(R_RB: Array, pose: Array) -> Array:
    """Twist of the tool about the rcm frame's z, continuous [rad]."""
    twists = []
    for quaternion in pose[:, 3:]:
        twist, _ = twist_angle(R_RB @ quaternion_xyzw_to_matrix(quaternion))
        twists.append(float(twist))
    return np.unwrap(twists)


def _samples(bag: rosbag.Bag, topic: str, values: Any) -> Samples:
    """The messages of a topic as numbers; of equal or earlier stamps the first counts."""
    stamps: list[int] = []
    rows: list[list[float]] = []
    for _, message, time in bag.read_messages([topic]):
        stamp = message.header.stamp.to_nsec() or time.to_nsec()
        if stamps and stamp <= stamps[-1]:
            continue
        try:
            row = values(message)
        except AttributeError:
            raise EpisodeError(
                f"{topic}: messages of type {message._type} cannot be used"
            ) from None
        if rows and len(row) != len(rows[0]):
            raise EpisodeError(f"{topic}: {len(row)} numbers after {len(rows[0])}")
        stamps.append(stamp)
        rows.append(row)
    if not rows:
        raise EpisodeError(f"{topic}: holds no message")
    numbers = np.array(rows, dtype=np.float64).reshape(len(rows), -1)
    if not np.isfinite(numbers).all():
        raise EpisodeError(f"{topic}: a value is not a number")
    return np.array(stamps, dtype=np.int64), numbers


def _resampled(
    bag: rosbag.Bag, arm: ArmTopics, key: str, values: Any, times: npt.NDArray[np.int64]
) -> Array:
    """A topic's numbers at other times, linear; the first and last value hold beyond its ends."""
    if key not in arm.topics:
        return np.zeros((len(times), 0))
    stamps, numbers = _samples(bag, arm.topics[key], values)
    if values is _pose:  # orientations: the newest
        newest = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, len(stamps) - 1)
        return np.hstack([_linear(stamps, numbers[:, :3], times), numbers[newest, 3:]])
    return _linear(stamps, numbers, times)


def _linear(stamps: npt.NDArray[np.int64], numbers: Array, times: npt.NDArray[np.int64]) -> Array:
    begin = stamps[0]
    at, known = (times - begin).astype(float), (stamps - begin).astype(float)
    return np.column_stack([np.interp(at, known, column) for column in numbers.T])


def _pose(message: Any) -> list[float]:
    """x, y, z and quaternion of a PoseStamped or TransformStamped."""
    if hasattr(message, "transform"):
        p, q = message.transform.translation, message.transform.rotation
    else:
        p, q = message.pose.position, message.pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _joints(message: Any) -> list[float]:
    """Positions, then velocities, of a JointState."""
    velocity = list(message.velocity) or [0.0] * len(message.position)
    return [*message.position, *velocity]


def _jaw(message: Any) -> list[float]:
    return list(message.position)[:1]


def _pictures(bag: rosbag.Bag, chosen: BagMap) -> Iterator[Picture]:
    names = {topic: camera for camera, topic in chosen.cameras.items()}
    if not names:
        return
    for topic, message, time in bag.read_messages(list(names)):
        if not message.header.stamp.to_nsec():
            message.header.stamp = time
        yield Picture(names[topic], message, time.to_nsec())
