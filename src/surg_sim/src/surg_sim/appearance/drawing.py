"""Visual parts of a scene: materials, meshes and primitives without mass or contact."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.appearance import textures
from surg_sim.appearance.anatomy import Mesh
from surg_sim.arrays import Array

OUTSIDE = 2
"""Group of geoms that the endoscope does not see: room, drape, skin. (URDF visuals: group 1.)"""


def add_materials(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Add the procedural materials of tissue, skin and cloth."""
    for name in ("fat", "bowel", "peritoneum"):
        add_material(spec, name, rng, specular=0.85, shininess=0.9)
    for name in ("skin", "cloth"):
        add_material(spec, name, rng, specular=0.12, shininess=0.2)


def add_material(
    spec: mujoco.MjSpec, name: str, rng: np.random.Generator, specular: float, shininess: float
) -> None:
    """Add a material with the procedural texture of the same name."""
    picture = textures.texture(name, 512, rng)
    spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=picture.shape[1],
        height=picture.shape[0],
        nchannel=3,
        data=picture.ravel(),
    )
    material = spec.add_material(name=name, specular=specular, shininess=shininess)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def add_mesh(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, mesh: Mesh, material: str, group: int = 0
) -> None:
    """Add a fixed visual surface."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        usertexcoord=mesh.uv.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=1,
    )
    kind = mujoco.mjtGeom.mjGEOM_MESH
    add_seen(body, kind, material, group, name=name, meshname=name)


def add_seen(
    body: mujoco.MjsBody, kind: mujoco.mjtGeom, material: str, group: int = OUTSIDE, **keys: object
) -> None:
    """Add a geom that is only seen, by default not by the endoscope."""
    unfelt = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    body.add_geom(type=kind, material=material, group=group, **unfelt, **keys)


def look(forward: Array, up: Array) -> Array:
    """Orientation of a MuJoCo camera (-z forwards, y up), as columns, (3, 3)."""
    z = -forward / np.linalg.norm(forward)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
