"""The pads of a jawed tool: a box on the inner face of a finger, felt by what it may hold."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np


def add_pad(
    spec: mujoco.MjSpec,
    name: str,
    side: str,
    size: Sequence[float],
    middle: float,
    bit: int,
    solref: Sequence[float],
    solimp: Sequence[float],
) -> None:
    """Put the pad ``<name>_<side>_pad`` on a finger.

    Args:
        spec: The scene with the tool in it.
        name: Of the tool: its joints begin with ``<name>_``.
        side: Joint of the finger, ``jaw`` or ``jaw_mirror``.
        size: Half lengths of the box (3,) [m].
        middle: Its middle along the finger [m].
        bit: Of the contacts that it makes.
        solref: Softness of these contacts, whatever the finger weighs.
        solimp: As MuJoCo defines it.

    Raises:
        ValueError: The tool has no such joint.
    """
    joint = spec.joint(f"{name}_{side}")
    if joint is None:
        raise ValueError(f"'{name}' has no joint '{side}': it cannot grasp")
    outward = np.cross(joint.axis, [0.0, 0.0, 1.0])  # where the finger goes when it opens
    joint.parent.add_geom(
        name=f"{name}_{side}_pad",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(size),
        pos=(outward * size[1] + [0.0, 0.0, middle]).tolist(),
        group=4,
        mass=0.0,
        contype=bit,
        conaffinity=0,
        condim=1,
        priority=1,
        solref=list(solref),
        solimp=list(solimp),
    )
