"""The part of URDF that the core needs: the joints between two links, as a chain or one pose.

The reader is C++ (``src/files/urdf.cpp``), the same for nodes, checks and simulator.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from surg_core import _core
from surg_core._core import (
    Chain,
    RobotConfig,
    Urdf,
    UrdfJoint,
    UrdfLimit,
    UrdfMimic,
    chain_of,
    joints_between,
)
from surg_core.transforms import FloatArray

__all__ = [
    "Urdf",
    "UrdfJoint",
    "UrdfLimit",
    "UrdfMimic",
    "chain_from_urdf",
    "fixed_transform",
    "load_chain",
    "load_urdf",
    "read_joints",
]


def load_urdf(path: str | os.PathLike[str]) -> Urdf:
    """Reads a URDF in the encoding that it states: its text, links and joints.

    Raises:
        ConfigError: for a missing or malformed file, xacro that nobody has expanded, a number that
            is none, or links and joints that are not one tree.
    """
    return _core.load_urdf(os.fspath(path))


def load_chain(robot: RobotConfig) -> Chain:
    """The chain of a robot from the URDF that its YAML names.

    Raises:
        ConfigError: as :func:`chain_from_urdf`, and where the YAML's limits are looser than the
            URDF's.
    """
    return _core.load_chain(robot)


def chain_from_urdf(
    path: str | os.PathLike[str], base_link: str, flange_link: str, joint_names: Sequence[str]
) -> Chain:
    """The serial chain from ``base_link`` to ``flange_link``, without a robot's YAML.

    Args:
        path: URDF file.
        base_link: link that the chain's poses are expressed in.
        flange_link: link at the end of the chain.
        joint_names: the turning joints in order from the base; must be exactly those on the way.
            Fixed joints in between are folded into them.

    Raises:
        ConfigError: for what :func:`load_urdf` refuses, an unknown link, no way from base to
            flange, a joint of a kind other than revolute, continuous or fixed, other joints than
            named, or one without the limits that URDF demands.
    """
    return chain_of(load_urdf(path), base_link, flange_link, joint_names)


def fixed_transform(path: str | os.PathLike[str], parent_link: str, child_link: str) -> FloatArray:
    """Pose ``(4, 4)`` of ``child_link`` in ``parent_link``, which only fixed joints may separate.

    Raises:
        ConfigError: as :func:`chain_from_urdf`, and for a joint on the way that is not fixed.
    """
    return _core.fixed_transform(load_urdf(path), parent_link, child_link)


def read_joints(path: str | os.PathLike[str], start: str, end: str) -> list[UrdfJoint]:
    """The joints from link ``start`` down to link ``end``, in this order, fixed ones included.

    Raises:
        ConfigError: for a missing or malformed file, an unknown link, no way from start to end, or
            a joint of a kind other than revolute, continuous or fixed.
    """
    return joints_between(load_urdf(path), start, end)
