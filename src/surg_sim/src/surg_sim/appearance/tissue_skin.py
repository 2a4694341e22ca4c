"""Draws the bowel: a tube around its nodes, pinched where jaws hold it, and its mesentery.

The scene holds two skins of fixed topology. For every picture their vertices are computed from the
joint positions and written into the renderer's scene. The centre line is a smooth curve through the
nodes; its frame is parallel-transported, and the normals come from the surface.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.appearance.anatomy import TEXTURE_LENGTH, grid_faces
from surg_sim.appearance.drawing import add_material
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.tissue import NAME, TissueParameters, rest_shape

TUBE, SHEET = f"{NAME}_tube", f"{NAME}_sheet"
"""Names of the two skins."""

_FINE = 3  # rings per node
_ROUND = 28  # vertices round the tube, the seam's twice
_ROWS = 9  # of the mesentery, from the tube to its root
_CLOSED, _OPEN = 0.20, 0.40  # [rad] jaw angles between which a pinch grows
_NEAR, _FAR = 0.003, 0.0075  # [m] distances of grip and centre line between which it fades
_WIDTH = 0.009  # [m] length of tube that is drawn into the jaws
_HANG = 0.55  # how far the section hangs below the grip, as a share of the radius
_THIN = 0.12  # share of its width that is left between the jaws
_GRIPPED, _DROP = 0.003, 0.011  # [m] depth below the grip at which it begins, and takes, to widen
_ROOT = (0.45, 0.064, -0.042)  # root of the mesentery: share of x, then y and z [m] of the patient

_BED = -0.0475  # [m] above the work point: what lies below carries the mesentery


def _weights(n: int) -> Array:
    """Catmull-Rom as a matrix: fine centre line = weights @ nodes, (rings, n)."""
    t = np.linspace(0.0, n - 1.0, (n - 1) * _FINE + 1)
    i = np.minimum(t.astype(int), n - 2)
    u = t - i
    parts = 0.5 * np.stack(
        [-u + 2 * u**2 - u**3, 2 - 5 * u**2 + 3 * u**3, u + 4 * u**2 - 3 * u**3, u**3 - u**2]
    )
    weights = np.zeros((len(t), n + 2))
    for k, part in enumerate(parts):
        weights[np.arange(len(t)), i + k] = part
    # The two points beyond the ends go on straight: p_-1 = 2 p_0 - p_1.
    inner = weights[:, 1:-1].copy()
    inner[:, 0] += 2 * weights[:, 0]
    inner[:, 1] -= weights[:, 0]
    inner[:, -1] += 2 * weights[:, -1]
    inner[:, -2] -= weights[:, -1]
    return inner


def add_skin(spec: mujoco.MjSpec, site: Site, parameters: TissueParameters) -> None:
    """Put the two skins into the scene; called by ``add_bowel`` when it has visuals."""
    # The tube's material is ``bowel``, which every scene with visuals has.
    add_material(spec, "mesentery", np.random.default_rng(5), specular=0.45, shininess=0.7)
    rings = (parameters.nodes - 1) * _FINE + 1
    along = np.linspace(0, (parameters.nodes - 1) * parameters.spacing, rings) / TEXTURE_LENGTH
    tube_uv = np.stack(np.meshgrid(along, np.linspace(0, 1, _ROUND), indexing="ij"), -1)
    _add(spec, TUBE, "bowel", grid_faces(rings, _ROUND), tube_uv, site.place([0, 0, 0]))

    sheet_uv = np.stack(np.meshgrid(along, np.linspace(0, 0.6, _ROWS), indexing="ij"), -1)
    front, count = grid_faces(rings, _ROWS), rings * _ROWS
    faces = np.concatenate([front, front[:, ::-1] + count])  # seen from both sides
    uv = np.concatenate([sheet_uv.reshape(-1, 2)] * 2)
    _add(spec, SHEET, "mesentery", faces, uv, site.place([0, 0, 0]))


def _add(
    spec: mujoco.MjSpec,
    name: str,
    material: str,
    faces: NDArray[np.int32],
    uv: Array,
    place: Array,
) -> None:
    """A skin that hangs on the world; where its vertices are is written when it is drawn."""
    count = uv.reshape(-1, 2).shape[0]
    skin = spec.add_skin(name=name, material=material, group=0)
    skin.vert = np.tile(place, count).tolist()
    skin.texcoord = uv.reshape(-1).tolist()
    skin.face = faces.ravel().tolist()
    skin.bodyname = ["world"]
    skin.bindpos = [0.0, 0.0, 0.0]
    skin.bindquat = [1.0, 0.0, 0.0, 0.0]
    skin.vertid = [list(range(count))]
    skin.vertweight = [[1.0] * count]


def _normals(grid: Array, closed: bool) -> Array:
    """Unit normals of a surface given as a grid of points, (rows, columns, 3)."""
    along = np.gradient(grid, axis=0)
    across = np.gradient(grid, axis=1)
    if closed:
        across[:, 0] = across[:, -1] = (grid[:, 1] - grid[:, -2]) / 2
    normal = np.cross(across, along)
    length = np.sqrt(np.einsum("ijk,ijk->ij", normal, normal))
    return np.asarray(normal / np.maximum(length, 1e-12)[..., None])


class BowelSkin:
    """Draws the bowel of a scene with visuals: a ``Skin``."""

    def __init__(self, model: mujoco.MjModel, site: Site, parameters: TissueParameters) -> None:
        n = parameters.nodes
        self._site, self._parameters = site, parameters
        self._base = rest_shape(site, parameters)
        start = int(model.joint(f"{NAME}_0_x").qposadr[0])
        self._qpos = slice(start, start + 3 * n)
        self._weights = _weights(n)
        self._tools = [
            (int(model.site(i).id), int(model.joint(f"{model.site(i).name[:-5]}_jaw").qposadr[0]))
            for i in range(model.nsite)
            if model.site(i).name.endswith("_grip")
        ]
        self._skins = [
            (int(model.skin(name).vertadr[0]), int(model.skin(name).vertnum[0]))
            for name in (TUBE, SHEET)
        ]
        angle = np.linspace(0, 2 * np.pi, _ROUND)
        self._cos, self._sin = np.cos(angle), np.sin(angle)
        self._radius = self._swelling(np.random.default_rng(0))

    def _swelling(self, rng: np.random.Generator) -> Array:
        """Radius of every vertex [m], (rings, round): swells, folds, and closes at the ends."""
        rings = len(self._weights)
        s = np.linspace(0, 1, rings)[:, None]
        phase = rng.uniform(0, 2 * np.pi, 6)
        angle = np.linspace(0, 2 * np.pi, _ROUND)[None, :]
        swell = (
            1
            + 0.055 * np.sin(2 * np.pi * 3.4 * s + phase[0])
            + 0.040 * np.sin(2 * np.pi * 7.7 * s + phase[1])
            + 0.022 * np.sin(2 * np.pi * 17.0 * s + phase[2] + 0.8 * np.sin(angle + phase[3]))
            + 0.030 * np.sin(angle + 2 * np.pi * 2.0 * s + phase[4])
            + 0.018 * np.sin(2 * angle - 2 * np.pi * 5.0 * s + phase[5])
        )
        end = np.minimum(s, 1 - s) * self._parameters.nodes * self._parameters.spacing
        cap = np.sqrt(np.clip(1 - (1 - end / self._parameters.radius) ** 2, 0, 1))
        cap[end >= self._parameters.radius] = 1.0
        return np.asarray(self._parameters.radius * swell * np.maximum(cap, 1e-3))

    def centre(self, data: mujoco.MjData) -> Array:
        """The tube's axis in the world [m], (rings, 3)."""
        nodes = self._base + data.qpos[self._qpos].reshape(-1, 3)
        return np.asarray(self._weights @ nodes)

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
        """Write the vertices; called after ``mjv_updateScene``."""
        centre = self.centre(data)
        tube = self._tube(centre, data)
        sheet = self._sheet(centre)
        self._write(scene, 0, tube, _normals(tube, closed=True))
        normal = _normals(sheet, closed=False)
        both = np.concatenate([sheet.reshape(-1, 3)] * 2)
        self._write(scene, 1, both, np.concatenate([normal.reshape(-1, 3), -normal.reshape(-1, 3)]))

    def _write(self, scene: mujoco.MjvScene, skin: int, points: Array, normals: Array) -> None:
        start, count = self._skins[skin]
        part = slice(3 * start, 3 * (start + count))
        scene.skinvert[part] = points.ravel()
        scene.skinnormal[part] = normals.ravel()

    def _tube(self, centre: Array, data: mujoco.MjData) -> Array:
        """Vertices of the tube, (rings, round, 3)."""
        tangent = np.gradient(centre, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        normal = _carried(tangent, self._site.R[:, 2])
        binormal = np.cross(tangent, normal)
        ring = (
            self._cos[None, :, None] * normal[:, None]
            + self._sin[None, :, None] * (binormal[:, None])
        )
        offset = self._radius[..., None] * ring
        for site, jaw in self._tools:
            self._pinch(offset, centre, data, site, float(data.qpos[jaw]))
        return np.asarray(centre[:, None] + offset)

    def _pinch(
        self, offset: Array, centre: Array, data: mujoco.MjData, site: int, jaw: float
    ) -> None:
        """Draw a fold of the tube into closed jaws that are on its axis, in place.

        The jaws hold the near edge: the section there hangs below the grip and narrows towards it
        like a drop.
        """
        grip, frame = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        squeeze, deep = frame[:, 1], frame[:, 2]  # the jaws close along their y
        distance = np.linalg.norm(centre - grip, axis=1)
        shut = np.clip((_OPEN - jaw) / (_OPEN - _CLOSED), 0.0, 1.0)
        near = np.clip((_FAR - distance.min()) / (_FAR - _NEAR), 0.0, 1.0)
        strength = float(shut * near)
        if strength <= 0.0:
            return
        weight = strength * np.exp(-0.5 * (distance / _WIDTH) ** 2)
        hang = _HANG * self._parameters.radius * weight
        depth = (offset + (centre - grip)[:, None]) @ deep + hang[:, None]
        open_ = np.clip((depth - _GRIPPED) / _DROP, 0.0, 1.0)
        open_ = open_ * open_ * (3.0 - 2.0 * open_)
        taken = weight[:, None] * (1.0 - _THIN) * (1.0 - open_)
        offset -= (taken * (offset @ squeeze))[..., None] * squeeze
        offset += hang[:, None, None] * deep

    def _sheet(self, centre: Array) -> Array:
        """Vertices of the mesentery from the tube to its root on the bed, (rings, rows, 3)."""
        local = (centre - self._site.work) @ self._site.R
        root = np.column_stack(
            [_ROOT[0] * local[:, 0], np.full(len(local), _ROOT[1]), np.full(len(local), _ROOT[2])]
        )
        share = np.linspace(0.0, 1.0, _ROWS)[None, :, None]
        sheet = (1 - share) * local[:, None] + share * root[:, None]
        length = np.linalg.norm(root - local, axis=1)[:, None]
        slack = np.clip(0.115 - length, 0.0, 0.05)  # it hangs through where it is not stretched
        s = np.linspace(0, 60, len(local))[:, None]
        fold = 0.0022 * np.sin(s + 1.3 * np.sin(0.37 * s))
        row = np.linspace(0.0, 1.0, _ROWS)[None, :]
        sheet[..., 2] += (fold - 0.35 * slack) * 4 * row * (1 - row)
        sheet[..., 2] = np.maximum(sheet[..., 2], _BED + 0.5 * fold)
        return np.asarray(self._site.work + sheet @ self._site.R.T)


def _carried(tangent: Array, up: Array) -> Array:
    """Unit normals carried along a curve without twist, (n, 3); the first as close to up as can be.

    Each is the last one made perpendicular to the new tangent. Plain floats: many short vectors.
    """
    x, y, z = (float(v) for v in up)
    normals = []
    for tx, ty, tz in tangent.tolist():
        along = x * tx + y * ty + z * tz
        x, y, z = x - along * tx, y - along * ty, z - along * tz
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1e-9:  # up runs along the tube: any other direction does
            x, y, z = (ty, -tx, 0.0) if tx or ty else (1.0, 0.0, 0.0)
            length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        normals.append((x, y, z))
    return np.array(normals)
