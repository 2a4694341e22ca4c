"""Shapes of the phantom as triangle meshes: tubes, surfaces over a grid, the domed abdominal wall.

Pure geometry: points in, ``Mesh`` out; units metres; faces are counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_sim.arrays import Array

TEXTURE_LENGTH = 0.12
"""Length of a tube after which its texture repeats [m]."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh with one texture coordinate per vertex."""

    vertices: Array  # (n, 3) positions [m]
    faces: NDArray[np.int32]  # (m, 3) vertex numbers, counter-clockwise from outside
    uv: Array  # (n, 2) texture coordinates

    def flipped(self) -> Mesh:
        """The same surface seen from the other side."""
        return Mesh(self.vertices, self.faces[:, ::-1], self.uv)


def grid_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles per cell of a (rows, columns) grid of vertices."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )


def smooth_curve(knots: Array, n: int) -> Array:
    """Catmull-Rom curve through the knots, (n, 3), ends included."""
    padded = np.vstack([2 * knots[0] - knots[1], knots, 2 * knots[-1] - knots[-2]])
    t = np.linspace(0, len(knots) - 1, n)
    i = np.minimum(t.astype(int), len(knots) - 2)
    u = (t - i)[:, None]
    p0, p1, p2, p3 = padded[i], padded[i + 1], padded[i + 2], padded[i + 3]
    return np.asarray(
        0.5
        * (
            2 * p1
            + (p2 - p0) * u
            + (2 * p0 - 5 * p1 + 4 * p2 - p3) * u**2
            + (3 * p1 - p0 - 3 * p2 + p3) * u**3
        )
    )


def tube(
    centre: Array,
    radius: Array,
    segments: int = 24,
    texture_start: tuple[float, float] = (0.0, 0.0),
) -> Mesh:
    """A tube about a curve with a parallel-transported frame, so that it never twists.

    Centre line (n, 3) [m], radius at each of its points (n,) [m].
    """
    tangent = np.gradient(centre, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    seed = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    normal = np.empty_like(centre)
    previous = seed
    for i, t in enumerate(tangent):
        previous = previous - (previous @ t) * t
        previous /= np.linalg.norm(previous)
        normal[i] = previous
    binormal = np.cross(tangent, normal)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    ring = (
        np.cos(angle)[None, :, None] * normal[:, None]
        + np.sin(angle)[None, :, None] * binormal[:, None]
    )
    vertices = centre[:, None] + radius[:, None, None] * ring
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    uv = np.empty((len(centre), segments + 1, 2))
    uv[..., 0] = texture_start[0] + (length / TEXTURE_LENGTH)[:, None]
    uv[..., 1] = texture_start[1] + np.linspace(0, 1, segments + 1)[None, :]
    faces = grid_faces(len(centre), segments + 1)
    return Mesh(vertices.reshape(-1, 3), faces, uv.reshape(-1, 2))


def bowel_loop(centre: Array, radius: float, rng: np.random.Generator) -> Mesh:
    """A piece of bowel along a curve: a tube whose radius [m] swells and narrows softly."""
    n = len(centre)
    phase = rng.random(3) * 2 * np.pi
    s = np.linspace(0, 1, n)
    swell = (
        1
        + 0.07 * np.sin(2 * np.pi * 3.1 * s + phase[0])
        + 0.05 * np.sin(2 * np.pi * 6.3 * s + phase[1])
        + 0.02 * np.sin(2 * np.pi * 13.0 * s + phase[2])
    )
    start = (float(rng.random()), float(rng.random()))
    return tube(centre, radius * swell, segments=20, texture_start=start)


def surface(
    height: Callable[[Array, Array], Array], x: Array, y: Array, texture_size: float
) -> Mesh:
    """The surface z = height(x, y) over increasing grid lines x by y [m], seen from above.

    The height takes two (len(x), len(y)) arrays; the texture repeats after ``texture_size`` [m].
    """
    xx, yy = np.meshgrid(x, y, indexing="ij")
    vertices = np.stack([xx, yy, height(xx, yy)], -1).reshape(-1, 3)
    uv = np.stack([xx, yy], -1).reshape(-1, 2) / texture_size
    return Mesh(vertices, grid_faces(len(x), len(y))[:, ::-1], uv)


def disc(
    height: Callable[[Array, Array], Array],
    half_length: float,
    half_width: float,
    texture_size: float,
) -> Mesh:
    """The surface z = height(x, y) over an ellipse with these half axes [m], seen from above.

    The height takes two equally shaped arrays; the texture repeats after ``texture_size`` [m].
    """
    rings, segments = 26, 48
    r, angle = np.meshgrid(
        np.linspace(0, 1, rings), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij"
    )
    x, y = half_length * r * np.cos(angle), half_width * r * np.sin(angle)
    vertices = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
    uv = np.stack([x, y], -1).reshape(-1, 2) / texture_size
    return Mesh(vertices, grid_faces(rings, segments + 1)[:, ::-1], uv)


@dataclass(frozen=True)
class Dome:
    """The inflated abdominal wall: half an ellipsoid with a window through which one looks in."""

    half_length: float  # half axis along x (head to feet) [m]
    half_width: float  # half axis along y [m]
    height: float  # top above the base plane [m]
    window: float  # half angle of the opening [rad]
    window_top: float  # polar height of its upper edge, 0 at the base, pi/2 at the top [rad]
    towards: float = -np.pi / 2  # azimuth of its middle from +x [rad]

    def point(self, azimuth: Array, rise: Array) -> Array:
        """Points of the surface; azimuth from +x [rad], rise 0..pi/2 from base to top."""
        return np.stack(
            [
                self.half_length * np.cos(azimuth) * np.cos(rise),
                self.half_width * np.sin(azimuth) * np.cos(rise),
                self.height * np.sin(rise),
            ],
            -1,
        )

    def inside(self, points: Array, share: float) -> Array:
        """Points (n, 3) drawn towards the middle until they are within this share of the wall."""
        room = share * np.sqrt(np.clip(1 - (points[:, 2] / self.height) ** 2, 0.05, 1))
        radius = np.hypot(points[:, 0] / self.half_length, points[:, 1] / self.half_width)
        pulled = points.copy()
        pulled[:, :2] *= np.minimum(1, room / np.maximum(radius, 1e-9))[:, None]
        return pulled

    def wall(self, columns: int = 120, rows: int = 40) -> Mesh:
        """The outside of the wall without the window."""
        # Azimuth runs once round, from one side of the window to the other.
        start = self.towards + self.window
        azimuth = np.linspace(start, start + 2 * np.pi - 2 * self.window, columns)
        parts = [self._patch(azimuth, np.linspace(0, np.pi / 2, rows))]
        above = np.linspace(self.towards - self.window, start, max(columns // 4, 2))
        parts.append(self._patch(above, np.linspace(self.window_top, np.pi / 2, rows // 2)))
        return join(parts)

    def _patch(self, azimuth: Array, rise: Array) -> Mesh:
        aa, rr = np.meshgrid(azimuth, rise, indexing="ij")
        vertices = self.point(aa, rr)
        uv = np.stack([vertices[..., 0], vertices[..., 1]], -1) / 0.25
        faces = grid_faces(len(azimuth), len(rise))[:, ::-1]
        return Mesh(vertices.reshape(-1, 3), faces, uv.reshape(-1, 2))

    def rim(self, thickness: float) -> Mesh:
        """The cut edge of the window, as a rounded hem of this radius [m]."""
        left, right = self.towards - self.window, self.towards + self.window
        up = np.linspace(0, self.window_top, 24)
        along = np.linspace(left, right, 36)[1:-1]
        azimuth = np.concatenate([np.full(24, left), along, np.full(24, right)])
        rise = np.concatenate([up, np.full(34, self.window_top), up[::-1]])
        curve = self.point(azimuth, rise)
        return tube(curve, np.full(len(curve), thickness), segments=14)


def join(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    offset, vertices, faces, uv = 0, [], [], []
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + offset)
        uv.append(mesh.uv)
        offset += len(mesh.vertices)
    return Mesh(np.vstack(vertices), np.vstack(faces).astype(np.int32), np.vstack(uv))
