"""Checks whether a motion fits an arm's workspace; it is refused, never rescaled.

Workspace in the rcm frame (origin at the trocar, z along the home shaft into the patient): depth
|p| between two spheres, and inside a cone about z. The motion is scaled about its centre, which
lies on the axis, so the scale at which a sample leaves the workspace has a closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from surg_core.arm_view import Array

WALL_MARGIN, WALL_ANGLE = 1e-4, 1e-3
"""[m], [rad] A limited target stays this far inside a wall."""


@dataclass(frozen=True)
class Workspace:
    """Where the tip may be commanded.

    Attributes:
        depth_min: Shallowest depth of a motion [m]: where lateral motion starts to fade.
        depth_max: Deepest [m].
        cone: Largest angle between shaft and home axis [rad], below pi/2.
    """

    depth_min: float
    depth_max: float
    cone: float

    def from_here(self, p: Array) -> Workspace:
        """For a way that begins at p (3,) in the rcm frame [m]: shallower, if p is, but no more."""
        depth = float(np.linalg.norm(p)) - WALL_MARGIN
        return self if depth >= self.depth_min else replace(self, depth_min=depth)

    def nearest(self, p: Array) -> tuple[Array, str]:
        """Limit a target to the workspace.

        It is turned onto the cone about the trocar, then moved along the shaft, to a point slightly
        inside because of rounding.

        Args:
            p: (3,) in the rcm frame, not the trocar itself [m].

        Returns:
            The point (3,) [m], p itself if it is inside; and the wall that limits it: ``cone``,
            ``depth_min``, ``depth_max``, or empty.
        """
        wall = ""
        depth = float(np.linalg.norm(p))
        cosine = math.cos(self.cone - WALL_ANGLE)
        if p[2] < depth * cosine:
            wall = "cone"
            aside = math.hypot(p[0], p[1])
            sine = math.sin(self.cone - WALL_ANGLE)
            across = p[:2] / aside if aside > 0.0 else np.array([1.0, 0.0])
            p = depth * np.array([sine * across[0], sine * across[1], cosine])
        low, high = self.depth_min + WALL_MARGIN, self.depth_max - WALL_MARGIN
        if not low <= depth <= high:
            wall = "depth_min" if depth < low else "depth_max"
            p = p * (min(max(depth, low), high) / depth)
        return p, wall


@dataclass(frozen=True)
class Exit:
    """Where a growing motion first leaves the workspace.

    Attributes:
        scale: The largest scale that fits; infinite if every scale does.
        index: Sample that leaves it.
        wall: The wall: ``depth_min``, ``depth_max`` or ``cone``.
    """

    scale: float
    index: int
    wall: str


def box_centre(p: Array) -> Array:
    """Centre (3,) [m] of the bounding box of positions (n, 3) [m]."""
    centre: Array = (p.min(axis=0) + p.max(axis=0)) / 2.0
    return centre


def largest_scale(offsets: Array, depth: float, workspace: Workspace) -> Exit:
    """Largest scale at which every sample stays inside.

    A sample sits at c + scale d with c = (0, 0, depth) and d its offset from the box's centre. It
    leaves through a wall at the smallest positive root of a quadratic in the scale:
    |c + scale d|^2 = r^2 for a sphere, (c_z + scale d_z)^2 = cos^2(cone) |c + scale d|^2 for the
    cone.

    `offsets` (n, 3) [m] are in axes of the rcm frame; the centre must lie inside the workspace.
    """
    d2 = np.einsum("ij,ij->i", offsets, offsets)
    dz = offsets[:, 2]
    cos2 = math.cos(workspace.cone) ** 2
    roots = {
        "depth_min": _first_root(d2, 2.0 * depth * dz, depth**2 - workspace.depth_min**2),
        "depth_max": _first_root(d2, 2.0 * depth * dz, depth**2 - workspace.depth_max**2),
        # The mirror image of the cone (z < 0) lies behind the trocar: the depth_min sphere is met
        # or the near side of the cone is crossed before it, so the smallest root is the right one.
        "cone": _first_root(
            dz**2 - cos2 * d2, 2.0 * depth * dz * (1.0 - cos2), depth**2 * (1.0 - cos2)
        ),
    }
    first = Exit(math.inf, 0, "none")
    for wall, scales in roots.items():
        index = int(np.argmin(scales))
        if scales[index] < first.scale:
            first = Exit(float(scales[index]), index, wall)
    return first


def _first_root(a: Array, b: Array, c: float) -> Array:
    """Smallest positive root of a x^2 + b x + c per entry, infinite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - 4.0 * a * c)
        # Citardauq's form where the usual one would cancel.
        q = -0.5 * (b + np.where(b < 0, -root, root))
        candidates = np.stack((q / a, c / q))
    candidates[~(candidates > 0) | ~np.isfinite(candidates)] = np.inf
    first: Array = candidates.min(axis=0)
    return first
