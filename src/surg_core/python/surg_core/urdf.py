"""The part of URDF that the core needs: the joints between two links, as a chain or one pose."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_core._core import Chain, ConfigError, Joint
from surg_core.transforms import FloatArray, make_pose

_TURNING = ("revolute", "continuous")


@dataclass(frozen=True)
class UrdfJoint:
    """One joint of a URDF.

    Attributes:
        name: Name in the URDF.
        kind: ``revolute``, ``continuous`` or ``fixed``.
        parent: Link it hangs on.
        child: Link that hangs on it.
        X_PJ: (4, 4) pose of the joint frame in the parent link at position 0 [m].
        axis: (3,) unit rotation axis in the joint frame.
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PJ: FloatArray
    axis: FloatArray

    @property
    def turning(self) -> bool:
        """True unless the joint is fixed."""
        return self.kind in _TURNING


def chain_from_urdf(
    path: str | os.PathLike[str], base_link: str, flange_link: str, joint_names: Sequence[str]
) -> Chain:
    """The serial chain from ``base_link`` to ``flange_link``.

    Args:
        path: URDF file.
        base_link: link that the chain's poses are expressed in.
        flange_link: link at the end of the chain.
        joint_names: the turning joints in order from the base; must be exactly those on the way.
            Fixed joints in between are folded into them.

    Raises:
        ConfigError: for a missing or malformed file, an unknown link, no way from base to flange, a
            joint of a kind other than revolute, continuous or fixed, or other joints than named.
    """
    joints = read_joints(path, base_link, flange_link)
    turning = [joint.name for joint in joints if joint.turning]
    if turning != list(joint_names):
        raise ConfigError(
            f"{path}: from link '{base_link}' to link '{flange_link}' the turning joints are "
            f"{', '.join(turning) or 'none'}; the robot's joints.names says "
            f"{', '.join(joint_names) or 'none'}"
        )
    chain: list[Joint] = []
    X = np.eye(4)  # of the present link in the last turning joint's frame
    for joint in joints:
        X = X @ joint.X_PJ
        if joint.turning:
            chain.append(Joint(joint.name, X, joint.axis))
            X = np.eye(4)
    try:
        return Chain(chain, X)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def fixed_transform(path: str | os.PathLike[str], parent_link: str, child_link: str) -> FloatArray:
    """Pose ``(4, 4)`` of ``child_link`` in ``parent_link``, which only fixed joints may separate.

    Raises:
        ConfigError: as :func:`chain_from_urdf`, and for a joint on the way that is not fixed.
    """
    X = np.eye(4)
    for joint in read_joints(path, parent_link, child_link):
        if joint.turning:
            raise ConfigError(
                f"{path}: joint '{joint.name}' between link '{parent_link}' and link "
                f"'{child_link}' is {joint.kind}; it must be fixed"
            )
        X = X @ joint.X_PJ
    return X


def read_joints(path: str | os.PathLike[str], start: str, end: str) -> list[UrdfJoint]:
    """The joints from link ``start`` down to link ``end``, in this order, fixed ones included.

    Raises:
        ConfigError: for a missing or malformed file, an unknown link, no way from start to end, or
            a joint of a kind other than revolute, continuous or fixed.
    """
    root = _read(path)
    links = [link.get("name", "") for link in root.findall("link")]
    for link in (start, end):
        if link not in links:
            raise ConfigError(f"{path}: has no link '{link}'; it has {', '.join(links)}")
    above: dict[str, ElementTree.Element] = {}
    for element in root.findall("joint"):
        child = _attribute(path, element, "child", "link")
        if child in above:
            raise ConfigError(f"{path}: link '{child}' is the child of two joints")
        above[child] = element
    way: list[UrdfJoint] = []
    link = end
    while link != start:
        if link not in above or len(way) > len(above):
            raise ConfigError(f"{path}: link '{end}' does not hang below link '{start}'")
        joint = _joint(path, above[link])
        way.append(joint)
        link = joint.parent
    return way[::-1]


def _read(path: str | os.PathLike[str]) -> ElementTree.Element:
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ElementTree.ParseError as error:
        raise ConfigError(f"{path}:{error.position[0]}: not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise ConfigError(f"{path}: the root element is <{root.tag}>; a URDF's is <robot>")
    return root


def _joint(path: str | os.PathLike[str], element: ElementTree.Element) -> UrdfJoint:
    name = element.get("name", "")
    kind = element.get("type", "")
    if kind not in (*_TURNING, "fixed"):
        raise ConfigError(
            f"{path}: joint '{name}' is of type '{kind}'; allowed are revolute, continuous, fixed"
        )
    origin = element.find("origin")
    xyz = _numbers(path, name, origin, "xyz", (0.0, 0.0, 0.0))
    rpy = _numbers(path, name, origin, "rpy", (0.0, 0.0, 0.0))
    axis = _numbers(path, name, element.find("axis"), "xyz", (1.0, 0.0, 0.0))
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and not length > 1e-9:
        raise ConfigError(f"{path}: joint '{name}': the axis has length zero")
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_attribute(path, element, "parent", "link"),
        child=_attribute(path, element, "child", "link"),
        X_PJ=make_pose(xyz, _rotation(rpy)),
        axis=axis / length if length > 0.0 else axis,
    )


def _rotation(rpy: FloatArray) -> FloatArray:
    """Rotation of URDF's ``rpy``, to the last bit what a node gets that reads the same file.

    The node's way is urdfdom's quaternion, then Eigen's normalisation and matrix: every product and
    sum in their order. A last bit that differs would grow into another trajectory within seconds,
    and simulations with and without ROS could not be compared by their hash.
    """
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a / 2.0), math.cos(a / 2.0)) for a in rpy.tolist())
    x = sx * cy * cz - cx * sy * sz
    y = cx * sy * cz + sx * cy * sz
    z = cx * cy * sz - sx * sy * cz
    w = cx * cy * cz + sx * sy * sz
    length = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / length, y / length, z / length, w / length
    length = math.sqrt((x * x + z * z) + (y * y + w * w))
    x, y, z, w = x / length, y / length, z / length, w / length
    tx, ty, tz = 2.0 * x, 2.0 * y, 2.0 * z
    return np.array(
        [
            [1.0 - (ty * y + tz * z), ty * x - tz * w, tz * x + ty * w],
            [ty * x + tz * w, 1.0 - (tx * x + tz * z), tz * y - tx * w],
            [tz * x - ty * w, tz * y + tx * w, 1.0 - (tx * x + ty * y)],
        ]
    )


def _attribute(
    path: str | os.PathLike[str], joint: ElementTree.Element, tag: str, attribute: str
) -> str:
    element = joint.find(tag)
    value = element.get(attribute) if element is not None else None
    if not value:
        raise ConfigError(
            f"{path}: joint '{joint.get('name', '')}' has no <{tag} {attribute}=\"…\"/>"
        )
    return value


def _numbers(
    path: str | os.PathLike[str],
    joint: str,
    element: ElementTree.Element | None,
    attribute: str,
    default: tuple[float, float, float],
) -> FloatArray:
    text = element.get(attribute) if element is not None else None
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ConfigError(
            f"{path}: joint '{joint}': {attribute}=\"{text}\" is not three finite numbers"
        )
    return values
