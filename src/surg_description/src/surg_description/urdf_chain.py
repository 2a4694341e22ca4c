"""Forward kinematics of one chain of a URDF, in plain numpy.

Only what writing a cell needs: the pose of one link in another at given joint positions. The
controller has its own kernels; tests compare the two, MuJoCo, KDL and the DH formula.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


class UrdfError(ValueError):
    """A URDF that cannot be used: says which file, what was wrong and what is allowed."""


@dataclass(frozen=True)
class UrdfJoint:
    """One joint on the way from the root link to the end link.

    Attributes:
        name: Name in the URDF.
        moving: True for revolute and continuous joints, False for fixed ones.
        X_PJ: (4, 4) pose of the joint frame in its parent link at position 0 [m].
        axis: (3,) unit rotation axis in the joint frame.
    """

    name: str
    moving: bool
    X_PJ: Matrix
    axis: Matrix


@dataclass(frozen=True)
class UrdfChain:
    """The joints between two links, root first.

    Attributes:
        joints: All joints on the path, fixed ones included.
    """

    joints: tuple[UrdfJoint, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the moving joints, root first."""
        return tuple(joint.name for joint in self.joints if joint.moving)

    def forward(self, positions: Mapping[str, float] | None = None) -> Matrix:
        """Pose of the end link in the root link.

        Args:
            positions: Joint positions [rad] by name; joints that are not named stay at 0.

        Returns:
            (4, 4) homogeneous transform, lengths in m.
        """
        positions = positions or {}
        pose = np.eye(4)
        for joint in self.joints:
            pose = pose @ joint.X_PJ
            if joint.moving:
                turn = np.eye(4)
                turn[:3, :3] = axis_rotation(joint.axis, float(positions.get(joint.name, 0.0)))
                pose = pose @ turn
        return pose


def axis_rotation(axis: Matrix, angle: float) -> Matrix:
    """Rotation matrix of an angle [rad] about a unit axis (Rodrigues' formula).

    Args:
        axis: (3,) unit vector.
        angle: Angle [rad].

    Returns:
        (3, 3) rotation matrix.
    """
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Matrix = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return turned


def rpy_rotation(rpy: Matrix) -> Matrix:
    """Rotation matrix of URDF's roll, pitch, yaw [rad]: Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        rpy: (3,) angles [rad].

    Returns:
        (3, 3) rotation matrix.
    """
    unit = np.eye(3)
    turned: Matrix = (
        axis_rotation(unit[2], rpy[2])
        @ axis_rotation(unit[1], rpy[1])
        @ axis_rotation(unit[0], rpy[0])
    )
    return turned


def read_chain(urdf: Path, root_link: str, end_link: str) -> UrdfChain:
    """Reads the chain between two links of a URDF file.

    Args:
        urdf: The file.
        root_link: Link where the chain starts.
        end_link: Link where it ends; must lie below root_link.

    Returns:
        The chain, fixed joints included.

    Raises:
        UrdfError: The file cannot be read, is not a URDF, a link is missing, or a joint on the way
            is neither revolute, continuous nor fixed.
    """
    try:
        robot = ET.parse(urdf).getroot()
    except (OSError, ET.ParseError) as error:
        raise UrdfError(f"{urdf}: cannot be read as URDF: {error}") from error
    links = [link.get("name", "") for link in robot.findall("link")]
    for name in (root_link, end_link):
        if name not in links:
            raise UrdfError(f"{urdf}: no link '{name}'; there are: {', '.join(links)}")
    above = {}
    for element in robot.findall("joint"):
        child = element.find("child")
        if child is not None:
            above[child.get("link", "")] = element
    path: list[UrdfJoint] = []
    link = end_link
    while link != root_link:
        if link not in above or len(path) > len(links):
            raise UrdfError(f"{urdf}: link '{end_link}' does not hang on link '{root_link}'")
        element = above[link]
        path.append(_read_joint(urdf, element))
        parent = element.find("parent")
        link = "" if parent is None else parent.get("link", "")
    return UrdfChain(tuple(reversed(path)))


def _read_joint(urdf: Path, element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    if kind not in ("revolute", "continuous", "fixed"):
        raise UrdfError(
            f"{urdf}: joint '{name}' is of type '{kind}'; allowed: revolute, continuous, fixed"
        )
    pose = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        pose[:3, 3] = _vector(urdf, name, origin.get("xyz", "0 0 0"))
        pose[:3, :3] = rpy_rotation(_vector(urdf, name, origin.get("rpy", "0 0 0")))
    axis = np.array([1.0, 0.0, 0.0])  # URDF's default
    given = element.find("axis")
    if given is not None:
        axis = _vector(urdf, name, given.get("xyz", "1 0 0"))
    length = float(np.linalg.norm(axis))
    if not length > 1e-9:
        raise UrdfError(f"{urdf}: joint '{name}' has the axis 0 0 0; allowed: any other direction")
    return UrdfJoint(name, kind != "fixed", pose, axis / length)


def _vector(urdf: Path, joint: str, text: str) -> Matrix:
    try:
        vector = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise UrdfError(f"{urdf}: joint '{joint}': '{text}' is not three numbers") from error
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise UrdfError(f"{urdf}: joint '{joint}': '{text}' is not three finite numbers")
    return vector
