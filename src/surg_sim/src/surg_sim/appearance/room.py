"""The room round the patient: table, pedestals, lamps and the spectator's camera."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from surg_sim.appearance.drawing import add_seen, look
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import quaternion

OVERVIEW = "overview"
"""Name of the camera that looks at the room."""
BED_DEPTH = 0.056
"""Work point to the tissue bed [m]: below every bundled motion."""
TABLE_DEPTH = 0.080
"""Tissue bed to the table's top [m]."""


@dataclass(frozen=True)
class Table:
    """The table top in patient axes about the work point [m]: edges in x, ends in y."""

    near: float
    far: float
    foot: float
    head: float


def table_of(site: Site) -> Table:
    """As wide as the robots beside it allow."""
    across = [float(site.local(base)[0]) for base in site.bases]
    reach = float(np.hypot(*(site.work - site.base)[:2]))
    near = min([reach, *(-x for x in across[1:] if x < 0)])
    far = min([0.47, *(x for x in across[1:] if x > 0)])
    return Table(
        near=-float(np.clip(near - 0.13, 0.15, 0.32)),
        far=float(np.clip(far - 0.13, 0.15, 0.34)),
        foot=-1.05,
        head=0.75,
    )


def add_room(spec: mujoco.MjSpec, site: Site) -> None:
    """Ground, operating table and a pedestal for every robot."""
    world, table = spec.worldbody, table_of(site)
    top = float(site.work[2]) - BED_DEPTH - TABLE_DEPTH
    ground = min(top, float(site.bases[:, 2].min())) - 0.62
    quat = quaternion(site.R).tolist()
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    add_seen(world, mujoco.mjtGeom.mjGEOM_PLANE, "ground", pos=[0, 0, ground], size=[8, 8, 0.1])

    bed = world.add_body(name="table", pos=[site.work[0], site.work[1], top], quat=quat)
    middle, half = (table.near + table.far) / 2, (table.far - table.near) / 2
    centre, length = (table.foot + table.head) / 2, (table.head - table.foot) / 2
    for material, low, high, x, y in (
        ("mattress", -0.050, 0.0, half, length),
        ("table", -0.080, -0.050, half - 0.01, length - 0.01),
        ("pedestal", ground - top + 0.06, -0.080, 0.10, 0.16),
        ("table", ground - top, ground - top + 0.06, 0.24, 0.42),
    ):
        size = [x, y, (high - low) / 2]
        add_seen(bed, box, material, pos=[middle, centre, (low + high) / 2], size=size)

    for base in site.bases:
        height = float(base[2]) - ground
        for material, low, high, radius in (
            ("pedestal", 0.0, height, 0.09),
            ("table", 0.0, 0.04, 0.24),
            ("table", height - 0.016, height - 0.001, 0.115),
        ):
            add_seen(
                world,
                cylinder,
                material,
                size=[radius, (high - low) / 2, 0],
                pos=[base[0], base[1], ground + (low + high) / 2],
            )


_ONE, _TWO = (-0.10, 0.90, -0.42), (-0.56, 0.70, -0.33)
"""How the spectator looks, in patient axes: past one robot; from the side that two leave free."""


def add_overview(spec: mujoco.MjSpec, site: Site, seen: Array) -> None:
    """The spectator, far enough away to see these points (n, 3) and the patient; two lamps."""
    fovy, aspect, margin = 36.0, 16 / 9, 0.10
    corners = [site.place([x, y, -0.05]) for x in (-0.20, 0.24) for y in (-0.34, 0.2)]
    points = np.vstack([seen, corners])
    forward = np.array(_ONE if len(site.bases) == 1 else _TWO)
    R = look(site.R @ forward, np.array([0.0, 0.0, 1.0]))
    local = points @ R  # camera axes: x right, y up, z towards the spectator
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    half = np.tan(np.radians(fovy) / 2) * np.array([aspect, 1.0])
    needed = (np.abs(local[:, :2] - middle[:2]) + margin) / half + local[:, 2:]
    eye = R @ np.array([middle[0], middle[1], needed.max()])
    world = spec.worldbody
    world.add_camera(name=OVERVIEW, pos=eye.tolist(), quat=quaternion(R).tolist(), fovy=fovy)
    for name, place, strength in (
        ("lamp", [0.5, -0.9, 1.7], 0.62),
        ("fill", [-1.2, -0.3, 1.3], 0.28),
    ):
        position = site.place(place)
        direction = site.work - position
        world.add_light(
            name=name,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=position.tolist(),
            dir=(direction / np.linalg.norm(direction)).tolist(),
            castshadow=False,
            ambient=[0.0, 0.0, 0.0],
            diffuse=[strength] * 3,
            specular=[0.25 * strength] * 3,
        )
