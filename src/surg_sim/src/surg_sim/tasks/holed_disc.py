"""A disc with a round hole that things can be put through: flat walls, each tangent to the hole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

_SIDES = 12  # of a drawn rim


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
        for i in range(_SIDES):
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[x[i], y[i], face, x[i + 1], y[i + 1], face],
                size=[thick, 0, 0], rgba=rgba, contype=0, conaffinity=0, mass=0.0,
            )  # fmt: skip
