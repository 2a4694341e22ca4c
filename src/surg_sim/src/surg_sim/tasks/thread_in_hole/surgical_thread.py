"""A surgical thread: a chain of point masses with bending stiffness, held near its middle.

The jaws hold the root, node ``GRIP``. From there one branch runs to the end that shall go through
the hole, another to the tail. Each piece has two hinges at the node before it, with a spring each:
the thread bends and does not stretch or twist. The springs' references are its curl, which a seed
draws.

A real thread of this length weighs some milligrams. This one is heavier and stiffer in the same
proportion, so that it hangs and sags alike; the hinges' armature bounds the fastest mode, which
makes steps of 1 ms stable whatever it touches.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array
from surg_sim.physics.spec_parts import add_part, quaternion

THREAD = "thread"
LENGTH, PIECES = 0.060, 30
"""Length [m], and number of pieces; there is one more point mass than pieces."""
PIECE = LENGTH / PIECES
"""Length of a piece [m]."""
GRIP = 12
"""Node that the jaws hold, counted from the end that shall go through the hole."""
FRONT = GRIP * PIECE
"""Length of thread from the jaws to that end [m]."""
RADIUS = 0.00025
"""Of the thread [m]: size 0 of a braided suture, about; assumed."""
MASS = 1.0e-4
"""Of the thread [kg]; assumed: about ten times silk's."""
BENDING = 4.0e-7
"""Bending stiffness E I [N m^2]; assumed: the front sags by 1.7 mm when it is level."""
CURL = 1.0 / 0.060
"""Largest drawn curvature of thread that nothing bends [1/m]; assumed."""
THREAD_BIT, FIGURE_BIT = 1 << 21, 1 << 22
"""Contact bits: the thread meets the figure and the floor, and nothing else."""

_STIFFNESS = BENDING / PIECE  # [N m/rad] of a hinge
_FASTEST = 500.0  # [rad/s] of any mode: steps of 1 ms resolve it
_ARMATURE = _STIFFNESS / _FASTEST**2  # [kg m^2]
_DAMPING = 1.5e-6  # [N m s/rad]: a third of critical at the front's own 90 rad/s
_COLOUR = [0.30, 0.16, 0.62, 1]
_END_COLOUR = [0.95, 0.55, 0.10, 1]


def add_thread(spec: mujoco.MjSpec, p_W: Array) -> None:
    """Put a free thread into the scene, its root at p_W (3,) [m]."""
    # The root is what the jaws pinch: enough inertia for a stiff hold.
    root = add_part(spec.worldbody, THREAD, 1e-5, [2e-8] * 3, pos=p_W.tolist())
    root.add_freejoint(name=THREAD)
    _add_branch(root, "front", GRIP, 0.0, _END_COLOUR)
    _add_branch(root, "tail", PIECES - GRIP, np.pi, _COLOUR)


def _add_branch(
    root: mujoco.MjsBody, name: str, pieces: int, turn: float, end: list[float]
) -> None:
    """Pieces along x of a frame that is turned about z [rad]."""
    body, place = root, [0.0, 0.0, 0.0]
    c, s = float(np.cos(turn)), float(np.sin(turn))
    quat = quaternion(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    for piece in range(pieces):
        body = body.add_body(name=f"{THREAD}_{name}_{piece}", pos=place, quat=quat.tolist())
        quat, place = np.array([1.0, 0.0, 0.0, 0.0]), [PIECE, 0.0, 0.0]
        # A point mass at the far node; MuJoCo needs an inertia above zero.
        body.mass, body.inertia = MASS / (PIECES + 1), [1e-13] * 3
        body.explicitinertial, body.ipos = True, [PIECE, 0.0, 0.0]
        for axis in "yz":
            joint = body.add_joint(
                name=f"{THREAD}_{name}_{piece}_{axis}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=np.eye(3)["xyz".index(axis)].tolist(),
                armature=_ARMATURE,
            )
            joint.stiffness, joint.damping = [_STIFFNESS, 0.0, 0.0], [_DAMPING, 0.0, 0.0]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0.0, 0.0, 0.0, PIECE, 0.0, 0.0],
            size=[RADIUS, 0, 0],
            rgba=end if piece >= pieces - 2 else _COLOUR,
            mass=0.0,
            contype=THREAD_BIT,
            conaffinity=FIGURE_BIT,
            condim=3,
            friction=[0.2, 0.001, 0.0001],
            solref=[0.004, 1.0],
            solimp=[0.9, 0.99, 0.0002, 0.5, 2.0],
        )


class SurgicalThread:
    """The thread in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._root = int(model.body(THREAD).id)
        front = [int(model.body(f"{THREAD}_front_{i}").id) for i in range(GRIP)]
        tail = [int(model.body(f"{THREAD}_tail_{i}").id) for i in range(PIECES - GRIP)]
        self._last = np.array([front[-1], tail[-1]])
        self._order = np.array([*front[::-1], *tail])
        self._joints = {
            branch: np.array(
                [
                    [int(model.joint(f"{THREAD}_{branch}_{i}_{axis}").qposadr[0]) for axis in "yz"]
                    for i in range(pieces)
                ]
            )
            for branch, pieces in (("front", GRIP), ("tail", PIECES - GRIP))
        }

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the curl of both branches, and put the thread into it."""
        for joints in self._joints.values():
            size, about = CURL * rng.uniform(), rng.uniform(0.0, 2.0 * np.pi)
            angles = PIECE * size * np.array([np.cos(about), np.sin(about)])
            self._data.qpos[joints] = angles
            self._model.qpos_spring[joints] = angles

    @property
    def nodes(self) -> Array:
        """All nodes from the end that shall go through the hole to the tail's [m], (31, 3)."""
        tips = self._data.xpos[self._last] + PIECE * self._data.xmat[self._last][:, [0, 3, 6]]
        inner = self._data.xpos[self._order]
        # A piece's body stands at its near node, so both first pieces stand at the root.
        return np.vstack([tips[:1], inner[: GRIP - 1], inner[GRIP:], tips[1:]])

    @property
    def end(self) -> Array:
        """The end that shall go through the hole, world [m], (3,)."""
        last = self._last[0]
        return np.asarray(self._data.xpos[last] + PIECE * self._data.xmat[last][[0, 3, 6]])

    @property
    def direction(self) -> Array:
        """Direction of the thread at that end, unit vector, world, (3,)."""
        return np.array(self._data.xmat[self._last[0]][[0, 3, 6]])
