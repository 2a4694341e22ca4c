"""Forward kinematics straight from a URDF's XML, independent of the core's chain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_sim.arrays import Array


@dataclass(frozen=True)
class Difference:
    """Largest difference between the core's chain and the URDF over drawn postures."""

    position: float  # [m]
    angle: float  # [rad]
    postures: int


def compare(arm: surg_core.Arm, postures: int = 200, seed: int = 0) -> Difference:
    """Compare ``arm.chain`` with the URDF over postures drawn inside the joint limits."""
    robot = arm.robot
    root = ElementTree.parse(arm.urdf_path).getroot()
    links = _path(root, robot.base_link, robot.flange_link)
    rng = np.random.default_rng(seed)
    low, high = np.asarray(robot.position_min), np.asarray(robot.position_max)
    position = angle = 0.0
    for _ in range(postures):
        q = rng.uniform(low, high)
        X = _forward(links, robot.joint_names, q)
        chain = np.asarray(arm.chain.forward(q))
        position = max(position, float(np.linalg.norm(X[:3, 3] - chain[:3, 3])))
        turn = X[:3, :3] @ chain[:3, :3].T
        angle = max(angle, math.acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))
    return Difference(position, angle, postures)


def _path(root: ElementTree.Element, base: str, flange: str) -> list[ElementTree.Element]:
    """The joints from base to flange."""
    by_child = {joint.find("child").get("link"): joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    path, link = [], flange
    while link != base:
        joint = by_child[link]
        path.append(joint)
        link = str(joint.find("parent").get("link"))  # type: ignore[union-attr]
    return path[::-1]


def _forward(joints: Sequence[ElementTree.Element], names: Sequence[str], q: Array) -> Array:
    """Pose (4, 4) of the flange in the base frame."""
    values = dict(zip(names, q, strict=True))
    X = np.eye(4)
    for joint in joints:
        origin = joint.find("origin")
        X = X @ _origin({} if origin is None else origin.attrib)
        if joint.get("type") != "fixed":
            axis = joint.find("axis")
            a = _numbers("1 0 0" if axis is None else str(axis.get("xyz")))
            turn = np.eye(4)
            turn[:3, :3] = axis_angle_to_matrix(
                a / np.linalg.norm(a), values[str(joint.get("name"))]
            )
            X = X @ turn
    return X


def _origin(attributes: dict[str, str]) -> Array:
    """Pose (4, 4) of ``<origin>``: fixed-axis roll, pitch, yaw."""
    roll, pitch, yaw = _numbers(attributes.get("rpy", "0 0 0"))
    X = np.eye(4)
    X[:3, :3] = (
        axis_angle_to_matrix([0.0, 0.0, 1.0], yaw)
        @ axis_angle_to_matrix([0.0, 1.0, 0.0], pitch)
        @ axis_angle_to_matrix([1.0, 0.0, 0.0], roll)
    )
    X[:3, 3] = _numbers(attributes.get("xyz", "0 0 0"))
    return X


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
