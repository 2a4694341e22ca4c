"""What is only looked at: materials, meshes and primitives without mass or contact."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.looks import textures
from surg_sim.looks.anatomy import Mesh

Array = NDArray[np.float64]

OUTSIDE = 2
"""Group of geoms that the endoscope cannot see: room, drape, skin. (URDF visuals: group 1.)"""


def add_materials(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """The procedural materials of tissue, skin and cloth."""
    wet = {"specular": 0.85, "shininess": 0.9}
    dry = {"specular": 0.12, "shininess": 0.2}
    for make, gloss in (
        (textures.fat, wet),
        (textures.bowel, wet),
        (textures.peritoneum, wet),
        (textures.skin, dry),
        (textures.cloth, dry),
    ):
        name = make.__name__
        picture = make(512, rng)
        spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=picture.shape[1],
            height=picture.shape[0],
            nchannel=3,
            data=picture.ravel(),
        )
        material = spec.add_material(name=name, **gloss)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def add_mesh(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    mesh: Mesh,
    material: str,
    group: int = 0,
) -> None:
    """A fixed surface that is only seen."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        usertexcoord=mesh.uv.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=1,
    )
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        group=group,
        contype=0,
        conaffinity=0,
        mass=0.0,
    )


def add_seen(body: mujoco.MjsBody, type_: mujoco.mjtGeom, material: str, **keys: object) -> None:
    """A primitive that is only seen, from outside."""
    body.add_geom(
        type=type_,
        material=material,
        group=OUTSIDE,
        contype=0,
        conaffinity=0,
        mass=0.0,
        **keys,
    )


def look(forward: Array, up: Array) -> Array:
    """Orientation of a MuJoCo camera (-z forwards, y up), as columns, (3, 3)."""
    z = -forward / np.linalg.norm(forward)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
