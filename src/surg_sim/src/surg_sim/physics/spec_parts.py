"""Pieces that several parts of a scene are made of: stated masses, servos, pads of jaws."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from surg_sim.arrays import Array


def quaternion(R: Array) -> Array:
    """Rotation matrix (3, 3) to quaternion w, x, y, z (MuJoCo's order)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R, dtype=np.float64).ravel())
    return quat


def state_mass(body: mujoco.MjsBody, mass: float, inertia: Sequence[float]) -> None:
    """State mass [kg] and principal inertia (3,) [kg m^2]; the weight is compensated."""
    body.mass, body.inertia, body.explicitinertial, body.gravcomp = mass, inertia, True, 1.0


def add_part(
    parent: mujoco.MjsBody, name: str, mass: float, inertia: Sequence[float], **keys: object
) -> mujoco.MjsBody:
    """Add a body with a stated mass [kg] and principal inertia (3,) [kg m^2] about its origin."""
    body = parent.add_body(name=name, **keys)
    body.mass, body.inertia, body.explicitinertial = mass, inertia, True
    body.ipos = [0.0, 0.0, 0.0]  # not stated, the compiler takes the place of the body for it
    return body


def add_wire(body: mujoco.MjsBody, places: Iterable[Array], radius: float, **keys: object) -> None:
    """Add capsules of a radius [m] from place to place (3,) [m]."""
    for start, end in itertools.pairwise(places):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*start, *end],
            size=[radius, 0, 0],
            mass=0.0,
            **keys,
        )


def add_position_servo(spec: mujoco.MjSpec, joint: str, stiffness: float, armature: float) -> None:
    """Put the servo ``<joint>_servo`` on a joint, critically damped for its armature.

    Stiffness in N m/rad or N/m, armature in kg m^2 or kg.
    """
    target = spec.joint(joint)
    target.armature = armature
    servo = spec.add_actuator(
        name=f"{joint}_servo",
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    servo.gainprm[0] = stiffness
    servo.biasprm[1:3] = [-stiffness, -2.0 * np.sqrt(stiffness * armature)]


def add_sprung_joint(
    body: mujoco.MjsBody, name: str, kind: mujoco.mjtJoint, axis: int, k: float, m: float
) -> None:
    """A slide or hinge about axis 0, 1 or 2 that a critically damped spring keeps at its reference.

    Stiffness k in N/m or N m/rad, armature m in kg or kg m^2.
    """
    damping = float(2.0 * np.sqrt(k * m))
    joint = body.add_joint(name=name, type=kind, axis=np.eye(3)[axis].tolist(), armature=m)
    joint.stiffness, joint.damping = [k, 0.0, 0.0], [damping, 0.0, 0.0]


def add_mark(parent: mujoco.MjsBody, name: str, axes: str) -> mujoco.MjsBody:
    """A body that slides along axes to what is asked, by joints ``<name>_<axis>``; only seen.

    A picture needs the joint positions alone, so all episodes share one compiled scene.
    """
    mark = add_part(parent, name, 0.01, [1e-6] * 3, gravcomp=1.0)
    for axis in axes:
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        add_sprung_joint(mark, f"{name}_{axis}", slide, "xyz".index(axis), 2e4, 0.5)
    return mark


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
    """Put the pad ``<name>_<side>_pad`` on a finger of a tool; its joints begin with ``<name>_``.

    Args:
        spec: The scene with the tool in it.
        name: Of the tool.
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
