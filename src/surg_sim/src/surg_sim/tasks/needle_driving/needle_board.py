"""The board of needle driving: a plate with four windows, a disc with a hole in each of them.

Plate and discs hang on springs. A seed changes the references of the discs' springs only, so all
boards share one compiled scene, and a picture needs the joint positions alone. What the constraints
do to the plate's six joints is the load of the needle on plate and discs together.

The plate stands across the direction in which the needle is driven, perpendicular to the shaft
where the jaws then are.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_core.transforms import make_pose
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import add_mark, add_part, add_sprung_joint, quaternion
from surg_sim.tasks.holed_disc import add_floor, add_holed_disc, add_rims, facing_pose

HOLES = 4
"""Number of holes, one below the other."""
HOLE_RADIUS, THICKNESS = 0.001, 0.0015
"""Of a hole, and of the disc that it goes through [m]."""
LARGEST_TILT = np.radians(25.0)
"""Of a hole's axis against the plate's normal [rad]."""
SHIFT = 0.0018
"""Largest shift of a hole from the middle of its window, per axis [m]."""
NEEDLE_BIT, BOARD_BIT = 1 << 19, 1 << 20
"""Contact bits: the needle meets the board, and nothing else."""

_PITCH = 0.012  # [m] from window to window
_WINDOW, _HALF_WIDTH, _HALF_THICK = 0.0055, 0.009, 0.00075  # [m] half sizes; half the plate's
_DISC_RADIUS, _WALLS = 0.0035, 12  # [m]; flat walls round a hole
_CENTRE = (-0.006, 0.022)  # [m] of the board from the work point: across, and in drive direction
_JAWS = (0.011, 0.012)  # [m] the same of the jaws while they drive
# Plate and discs give way like printed parts: 2 N move them by 0.1 mm; assumed.
_STIFFNESS, _MASS = 2e4, 0.5  # [N/m], [kg] armature
_TURN_STIFFNESS, _INERTIA = 5.0, 1.25e-4  # [N m/rad], [kg m^2] armature
_SURFACE = {  # stiff against a needle of 2 g; steel on a printed part, friction assumed
    "contype": BOARD_BIT, "conaffinity": NEEDLE_BIT, "condim": 3, "mass": 0.0,
    "friction": [0.3, 0.001, 0.0001], "solref": [0.003, 1.0],
    "solimp": [0.9, 0.99, 0.0002, 0.5, 2.0],
}  # fmt: skip
_SEEN = {"contype": 0, "conaffinity": 0, "mass": 0.0}
_BOX, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
_PLATE = [0.34, 0.42, 0.52, 1]
_DISC = [0.80, 0.78, 0.70, 1]
_RIM = [0.10, 0.10, 0.12, 1]
_MARK = [0.10, 0.80, 0.25, 1]
_FOOT = [0.20, 0.25, 0.31, 1]


def board_pose(site: Site) -> Array:
    """Pose of the board in the world, (4, 4).

    x points to the side where the jaws are, y along the shaft, z is the plate's normal, along which
    the needle is driven.
    """
    X = facing_pose(site, *_JAWS)
    X[:3, 3] = site.work + _CENTRE[0] * X[:3, 0] + _CENTRE[1] * X[:3, 2]
    return X


def _along(hole: int) -> float:
    """Place of a window along the board's y axis [m]."""
    return (hole - (HOLES - 1) / 2) * _PITCH


def add_board(spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
    """Put the board and a floor below it into the scene; with ``visuals`` also the board's foot."""
    X = board_pose(site)
    place = {"pos": X[:3, 3].tolist(), "quat": quaternion(X[:3, :3]).tolist(), "gravcomp": 1.0}
    plate = add_part(spec.worldbody, "needle_board", 0.02, [1e-5] * 3, **place)
    _add_springs(plate, "needle_board", "xyz")
    end = HOLES / 2 * _PITCH + 0.003
    rail = (_HALF_WIDTH - _WINDOW) / 2
    for side in (-1, 1):
        _box(plate, [side * (_WINDOW + rail), 0, 0], [rail, end, _HALF_THICK], _PLATE)
        height = (end - (_along(HOLES - 1) + _WINDOW)) / 2
        _box(plate, [0, side * (end - height), 0], [_WINDOW, height, _HALF_THICK], _PLATE)
    for hole in range(HOLES - 1):
        bar = [_WINDOW, _PITCH / 2 - _WINDOW, _HALF_THICK]
        _box(plate, [0, _along(hole) + _PITCH / 2, 0], bar, _PLATE)
    for hole in range(HOLES):
        _add_disc(plate, hole)
    _add_mark(plate)
    floor = add_floor(spec, site, _SURFACE)
    if visuals:
        _add_foot(spec, X, end, float(floor[2]))


def _box(body: mujoco.MjsBody, pos: list[float], size: list[float], rgba: list[float]) -> None:
    body.add_geom(type=_BOX, pos=pos, size=size, rgba=rgba, **_SURFACE)


def _add_disc(plate: mujoco.MjsBody, hole: int) -> None:
    """A disc on two slides and two hinges; flat walls, each tangent to the hole, make it up."""
    place = {"pos": [0.0, _along(hole), 0.0], "gravcomp": 1.0}
    disc = add_part(plate, f"hole_{hole}", 0.01, [1e-6] * 3, **place)
    _add_springs(disc, f"hole_{hole}", "xy")
    add_holed_disc(disc, HOLE_RADIUS, _DISC_RADIUS, THICKNESS, _WALLS, _DISC, _SURFACE)
    for side in (-1, 1):  # pins on which it tilts, seen only
        ends = [side * (_DISC_RADIUS - 0.0005), 0, 0, side * _WINDOW, 0, 0]
        disc.add_geom(type=_CAPSULE, fromto=ends, size=[0.0005, 0, 0], rgba=_PLATE, **_SEEN)
    add_rims(disc, HOLE_RADIUS + 0.0002, THICKNESS / 2, 0.0002, _RIM)


def _add_springs(body: mujoco.MjsBody, name: str, axes: str) -> None:
    """Slides ``<name>_at_x`` and so on, then hinges ``<name>_tilt_x``, on springs."""
    for word, kind, k, m in (
        ("at", mujoco.mjtJoint.mjJNT_SLIDE, _STIFFNESS, _MASS),
        ("tilt", mujoco.mjtJoint.mjJNT_HINGE, _TURN_STIFFNESS, _INERTIA),
    ):
        for axis in axes:
            add_sprung_joint(body, f"{name}_{word}_{axis}", kind, "xyz".index(axis), k, m)


def _add_mark(plate: mujoco.MjsBody) -> None:
    """A green frame that slides to the window of the asked hole."""
    mark = add_mark(plate, "asked_hole", "y")
    out, half = _WINDOW + 0.0002, 0.0005
    for side in (-1, 1):
        for pos, size in (([side * out, 0, 0], [half, out + half, 0.0010]),
                          ([0, side * out, 0], [out + half, half, 0.0010])):  # fmt: skip
            mark.add_geom(type=_BOX, pos=pos, size=size, rgba=_MARK, **_SEEN)


def _add_foot(spec: mujoco.MjSpec, X: Array, end: float, height: float) -> None:
    """Two legs from the plate's lower end to a tray at a height in the tissue bed."""
    top = X[:3, :3] @ np.array([0.0, end, 0.0]) + X[:3, 3]
    floor = np.array([top[0], top[1], height])
    for side in (-1, 1):
        beside = side * 0.0072 * X[:3, 0]
        spec.worldbody.add_geom(
            type=_CAPSULE, fromto=[*(top + beside), *(floor + beside)], size=[0.0016, 0, 0],
            rgba=_FOOT, **_SEEN,
        )  # fmt: skip
    spec.worldbody.add_geom(
        type=_BOX, pos=floor.tolist(), size=[0.022, 0.016, 0.002], rgba=_FOOT, **_SEEN
    )


class NeedleBoard:
    """The board in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._bodies = [int(model.body(f"hole_{hole}").id) for hole in range(HOLES)]
        self._joints = np.array(
            [
                [int(model.joint(f"hole_{hole}_{word}_{axis}").qposadr[0])
                 for word in ("at", "tilt") for axis in "xy"]
                for hole in range(HOLES)
            ]
        )  # fmt: skip
        self._plate = int(model.body("needle_board").id)
        R_WRest = np.empty(9)  # the axes of the slides
        mujoco.mju_quat2Mat(R_WRest, model.body_quat[self._plate])
        self._rest = R_WRest.reshape(3, 3)
        first = int(model.joint("needle_board_at_x").dofadr[0])
        self._dofs = slice(first, first + 6)
        self._mark = int(model.joint("asked_hole_y").qposadr[0])

    def reset(self, rng: np.random.Generator) -> int:
        """Draw places and tilts of the holes, and the asked one, which is marked; returns it."""
        tilt = rng.uniform(0.0, LARGEST_TILT, HOLES)
        about = rng.uniform(0.0, 2.0 * np.pi, HOLES)
        shift = rng.uniform(-SHIFT, SHIFT, (HOLES, 2))
        asked = int(rng.integers(HOLES))
        drawn = np.column_stack([shift, tilt * np.cos(about), tilt * np.sin(about)])
        self._set(self._joints, drawn)
        self._set(np.array(self._mark), np.array(_along(asked)))
        return asked

    def _set(self, at: Array, values: Array) -> None:
        self._data.qpos[at] = values
        self._model.qpos_spring[at] = values

    def load(self, p_W: Array) -> tuple[Array, Array]:
        """Force of board on needle [N] and its torque about a point p_W [N m], world, (3,) each.

        In the latest step; contacts themselves are already those of the next one.
        """
        R = self._rest
        on_plate = self._data.qfrc_constraint[self._dofs]
        force = -R @ on_plate[:3]
        arm = self._data.xpos[self._plate] - p_W
        return force, -R @ on_plate[3:] + np.cross(arm, force)

    @property
    def normal(self) -> Array:
        """Normal of the plate in the world, from its front to its back, (3,)."""
        return np.array(self._data.xmat[self._plate].reshape(3, 3)[:, 2])

    @property
    def poses(self) -> list[Array]:
        """Pose of each hole in the world, (4, 4): z through the hole, from the front."""
        return [self._pose(body) for body in self._bodies]

    def _pose(self, body: int) -> Array:
        return make_pose(self._data.xpos[body], self._data.xmat[body].reshape(3, 3))
