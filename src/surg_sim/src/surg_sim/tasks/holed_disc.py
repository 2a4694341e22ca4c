"""A disc with a round hole, before the jaws: its place, its walls, and the floor below it.

The walls are flat, each tangent to the hole.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from surg_core.transforms import make_pose
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import add_wire

_SIDES = 12  # of a drawn rim
_FLOOR = -0.052  # [m] of the floor about the work point


def add_holed_disc(
    body: mujoco.MjsBody,
    hole: float,
    disc: float,
    thickness: float,
    walls: int,
    rgba: list[float],
    surface: Mapping[str, Any],
) -> None:
    """Put walls round the z axis of a body; the hole is its origin.

    Args:
        body: In whose x-y plane the disc lies.
        hole: Radius of the hole [m].
        disc: Radius of the disc [m].
        thickness: Of the disc [m].
        walls: Their number; each is a box.
        rgba: Colour.
        surface: How the boxes touch: contact bits, friction, softness.
    """
    middle = (hole + disc) / 2
    size = [middle - hole, disc * np.tan(np.pi / walls), thickness / 2]
    for angle in np.arange(walls) * 2.0 * np.pi / walls:
        c, s = float(np.cos(angle)), float(np.sin(angle))
        turn = [float(np.cos(angle / 2)), 0.0, 0.0, float(np.sin(angle / 2))]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=[middle * c, middle * s, 0], quat=turn, size=size,
            rgba=rgba, **surface,
        )  # fmt: skip


def add_rims(
    body: mujoco.MjsBody, radius: float, z: float, thick: float, rgba: list[float]
) -> None:
    """Draw a rim of this radius and thickness [m] at both faces, z and -z; it is only seen."""
    angles = np.arange(_SIDES + 1) * 2.0 * np.pi / _SIDES
    x, y = radius * np.cos(angles), radius * np.sin(angles)
    for face in (-z, z):
        circle = np.column_stack([x, y, np.full(_SIDES + 1, face)])
        add_wire(body, circle, thick, rgba=rgba, contype=0, conaffinity=0)


def add_floor(spec: mujoco.MjSpec, site: Site, surface: Mapping[str, Any]) -> Array:
    """Add a floor where what was dropped comes to rest; returns a point of it, world [m], (3,)."""
    place = site.place([0.0, 0.0, _FLOOR])
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=place.tolist(),
        size=[0.5, 0.5, 0.1],
        group=4,
        **surface,
    )
    return place


def facing_pose(site: Site, across: float, ahead: float) -> Array:
    """Pose (4, 4) of jaws in the world so far beside and ahead of the work point [m].

    y along the shaft, z ahead as the endoscope looks, x across both.
    """
    place = site.work
    for _ in range(5):
        s = place - site.trocar
        s = s / np.linalg.norm(s)
        z = site.R[:, 1] - (site.R[:, 1] @ s) * s
        z = z / np.linalg.norm(z)
        x = np.cross(s, z)
        place = site.work + across * x + ahead * z
    return make_pose(place, np.column_stack([x, s, z]))
