"""The printed figure of thread in hole: a head with a hole of 4 mm, on a post in a foot.

The figure hangs on springs. A seed changes their references only, so all figures share one compiled
scene, and a picture needs the joint positions alone.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import add_part, add_sprung_joint, quaternion
from surg_sim.tasks.holed_disc import add_floor, add_holed_disc, add_rims, facing_pose
from surg_sim.tasks.thread_in_hole.surgical_thread import FIGURE_BIT, FRONT, THREAD_BIT

HOLE_RADIUS, THICKNESS = 0.002, 0.002
"""Of the hole, and of the head that it goes through [m]."""
LARGEST_TILT = np.radians(30.0)
"""Of the hole's axis against the direction ahead of the jaws [rad]."""
SHIFT = np.array([0.006, 0.006, 0.004])
"""Largest shift of the hole per axis: across, along the shaft, ahead [m]."""

_HEAD, _WALLS = 0.007, 16  # [m] radius; flat walls round the hole
_AHEAD = FRONT + 0.016  # [m] of the hole from the work point
_POST, _POST_LENGTH = 0.0016, 0.034  # [m] radius and length
_STIFFNESS, _MASS = 2e4, 0.5  # [N/m], [kg] armature: a printed part; assumed
_TURN_STIFFNESS, _INERTIA = 5.0, 1.25e-4  # [N m/rad], [kg m^2] armature
_SURFACE = {
    "contype": FIGURE_BIT, "conaffinity": THREAD_BIT, "condim": 3, "mass": 0.0,
    "friction": [0.2, 0.001, 0.0001], "solref": [0.004, 1.0],
    "solimp": [0.9, 0.99, 0.0002, 0.5, 2.0],
}  # fmt: skip
_SEEN = {"contype": 0, "conaffinity": 0, "mass": 0.0}
_PRINT = [0.88, 0.80, 0.55, 1]
_RIM = [0.10, 0.62, 0.30, 1]
_FOOT = [0.20, 0.25, 0.31, 1]


def figure_pose(site: Site) -> Array:
    """Pose of an undrawn hole in the world, (4, 4): y along the shaft, z ahead through the hole."""
    return facing_pose(site, 0.0, _AHEAD)


def add_figure(spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
    """Put the figure and a floor below it into the scene; with ``visuals`` also the foot."""
    X = figure_pose(site)
    place = {"pos": X[:3, 3].tolist(), "quat": quaternion(X[:3, :3]).tolist(), "gravcomp": 1.0}
    figure = add_part(spec.worldbody, "figure", 0.02, [1e-5] * 3, **place)
    for axis in range(3):
        name = f"figure_at_{'xyz'[axis]}"
        add_sprung_joint(figure, name, mujoco.mjtJoint.mjJNT_SLIDE, axis, _STIFFNESS, _MASS)
    down = X[:3, :3].T @ np.array([0.0, 0.0, -1.0])
    down[2] = 0.0
    down = down / np.linalg.norm(down)
    top = (_HEAD - 0.0005) * down
    foot = top + _POST_LENGTH * (X[:3, :3].T @ np.array([0.0, 0.0, -1.0]))
    figure.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*top, *foot], size=[_POST, 0, 0], rgba=_PRINT,
        **_SURFACE,
    )  # fmt: skip
    if visuals:
        upright = X[:3, :3].T @ np.eye(3)[2]
        figure.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, fromto=[*foot, *(foot - 0.004 * upright)],
            size=[0.012, 0, 0], rgba=_FOOT, **_SEEN,
        )  # fmt: skip
    head = add_part(figure, "figure_head", 0.01, [1e-6] * 3, gravcomp=1.0)
    for axis in range(2):
        name = f"figure_tilt_{'xyz'[axis]}"
        add_sprung_joint(head, name, mujoco.mjtJoint.mjJNT_HINGE, axis, _TURN_STIFFNESS, _INERTIA)
    add_holed_disc(head, HOLE_RADIUS, _HEAD, THICKNESS, _WALLS, _PRINT, _SURFACE)
    add_rims(head, HOLE_RADIUS + 0.0005, THICKNESS / 2, 0.0004, _RIM)
    add_floor(spec, site, _SURFACE)


class PrintedFigure:
    """The figure in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._head = int(model.body("figure_head").id)
        names = [f"figure_at_{axis}" for axis in "xyz"] + [f"figure_tilt_{axis}" for axis in "xy"]
        self._joints = np.array([int(model.joint(name).qposadr[0]) for name in names])

    def reset(self, rng: np.random.Generator) -> None:
        """Draw place and direction of the hole."""
        tilt, about = LARGEST_TILT * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
        drawn = [*(SHIFT * rng.uniform(-1.0, 1.0, 3)), tilt * np.cos(about), tilt * np.sin(about)]
        self._data.qpos[self._joints] = drawn
        self._model.qpos_spring[self._joints] = drawn

    @property
    def hole(self) -> Array:
        """Middle of the hole, world [m], (3,)."""
        return np.array(self._data.xpos[self._head])

    @property
    def axis(self) -> Array:
        """Axis of the hole from front to back, unit vector, world, (3,)."""
        return np.array(self._data.xmat[self._head][[2, 5, 8]])

    def inside(self, p_W: Array) -> Array:
        """A point of the world in the frame of the hole, z along its axis [m], (3,)."""
        R = self._data.xmat[self._head].reshape(3, 3)
        return np.asarray(R.T @ (p_W - self._data.xpos[self._head]))
