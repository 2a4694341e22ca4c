"""The assistant's instrument in the scene: a grasper on four servos about a pivot in the wall.

There is no robot behind it. The servos move yaw, pitch, insertion and roll, the virtual joints of
docs/reference/conventions.md.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import mujoco
import numpy as np

import surg_core
from surg_core.contract import VIRTUAL_JOINTS
from surg_sim.appearance.drawing import add_seen
from surg_sim.appearance.patient import draw_cannula, wall_height
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import add_position_servo, quaternion, state_mass
from surg_sim.physics.tool_drive import ARMATURE, STIFFNESS, WRIST_JOINTS

NAME = "assistant"
"""Prefix of everything of the assistant in a scene, and its name on the wire."""
JAWS = ("jaw", "jaw_mirror")
TIP = "tip"

_AIM = (0.0, 0.015, -0.030)  # [m] patient axes: a point of the shaft's axis at home
_STIFFNESS = (400.0, 400.0, 2e4, 40.0)  # [N m/rad, N/m] strong beside a few newton
_ARMATURE = (0.02, 0.02, 0.5, 0.002)  # [kg m^2, kg] assumed: hand and handle


def port_place(site: Site) -> tuple[float, float, float]:
    """The pivot in patient axes about the work point [m], (3,): in the wall.

    It lies on the other side of the patient's middle than the first arm's trocar.
    """
    x, y, _ = site.local(site.trocar)
    side = -1.0 if x > -0.02 else 1.0
    place = (float(side * max(abs(x), 0.075)), float(y))
    return (*place, wall_height(site, *place))


def port_frame(site: Site) -> Array:
    """Pose of the assistant's trocar frame in the world, (4, 4).

    Its z runs along the shaft at home; its x is the patient's x made perpendicular to it.
    """
    p_WRcm = site.place(port_place(site))
    z = site.place(_AIM) - p_WRcm
    z /= np.linalg.norm(z)
    x = site.R[:, 0] - (site.R[:, 0] @ z) * z
    x /= np.linalg.norm(x)
    return surg_core.make_pose(p_WRcm, np.column_stack([x, np.cross(z, x), z]))


def add_assistant(spec: mujoco.MjSpec, site: Site, instrument: Path, visuals: bool = False) -> None:
    """Put the instrument, its pivot and its servos into the scene.

    Of the grasper's URDF, shaft and jaws are taken, the robot's holder is not. ``visuals`` also
    draws the cannula in the wall and a handle.

    Raises:
        ValueError: The URDF is not that of a grasper.
    """
    X = port_frame(site)
    pivot = spec.worldbody.add_body(
        name=f"{NAME}_pivot", pos=X[:3, 3].tolist(), quat=quaternion(X[:3, :3]).tolist()
    )
    body = pivot
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    kinds, axes = (hinge, hinge, slide, hinge), ([0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 1])
    for name, kind, axis, stiffness, armature in zip(
        VIRTUAL_JOINTS, kinds, axes, _STIFFNESS, _ARMATURE, strict=True
    ):
        body = body.add_body(name=f"{NAME}_{name}")
        state_mass(body, 0.02, [1e-5] * 3)
        body.add_joint(name=f"{NAME}_{name}", type=kind, axis=axis)
        add_position_servo(spec, f"{NAME}_{name}", stiffness, armature)

    grasper = mujoco.MjSpec.from_string(instrument.read_text("utf-8"))
    if any(grasper.joint(name) is None for name in JAWS):
        raise ValueError(f"{instrument}: needs the joints {' and '.join(JAWS)} of a grasper")
    for name in WRIST_JOINTS:  # a hand at a handle: its wrist stays straight
        if grasper.joint(name) is not None:
            grasper.delete(grasper.joint(name))
    shaft = grasper.body("shaft")  # parallel to the mount, as is its tip: no rotation to undo
    to_tip = np.asarray(surg_core.fixed_transform(instrument, "shaft", TIP))[:3, 3]
    offset = -(np.asarray(shaft.pos) + to_tip)
    body.add_frame(pos=offset.tolist()).attach_body(shaft, f"{NAME}_", "")
    for name in JAWS:
        add_position_servo(spec, f"{NAME}_{name}", STIFFNESS, ARMATURE)
    for part in [pivot, *pivot.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        part.gravcomp = 1.0
    if visuals:
        draw_cannula(spec.body(f"{NAME}_pitch"), np.array([0.0, 0.0, 1.0]))  # turns with the shaft
        _draw_handle(body, -float(to_tip[2]))


def _draw_handle(body: mujoco.MjsBody, end: float) -> None:
    """The handle that the assistant's hand would hold, at the shaft's outer end on z [m].

    The body carries the shaft: the tip is its origin, z the shaft's axis.
    """

    def rod(start: Array, stop: Array, radius: float, material: str, kind: str) -> None:
        shape, ends = getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), [*start, *stop]
        add_seen(body, shape, material, fromto=ends, size=[radius, 0.0, 0.0])

    axis, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    back = end * axis
    rod(back + 0.012 * axis, back - 0.012 * axis, 0.011, "seal", "CYLINDER")  # turns the shaft
    rod(back - 0.012 * axis, back - 0.050 * axis, 0.007, "scope", "CYLINDER")
    around = np.linspace(0.0, 2.0 * np.pi, 13)
    for lean, ring in ((-0.15, 0.012), (-0.75, 0.014)):  # for the fingers, for the thumb
        away = np.cos(lean) * side + np.sin(lean) * axis
        root = back - 0.044 * axis
        centre = root + (0.075 + ring) * away
        rod(root, root + 0.075 * away, 0.0042, "scope", "CAPSULE")
        across = np.cross([1.0, 0.0, 0.0], away)
        loop = centre + ring * (
            np.cos(around)[:, None] * away + 1.5 * np.sin(around)[:, None] * across
        )
        for start, stop in itertools.pairwise(loop):
            rod(start, stop, 0.0034, "scope", "CAPSULE")
