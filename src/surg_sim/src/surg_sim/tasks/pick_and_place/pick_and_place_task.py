"""Peg transfer: lift a ring off its peg and put it over another one on the other board.

Success: the ring lies on the goal's board round the goal's peg, free and at rest for half a second,
within the time limit. A ring that comes to rest anywhere else but on its first peg is dropped.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.rigid_grasp import PAD_BIT, RigidGrasp, add_rigid_grasp
from surg_sim.physics.spec_parts import add_mark, add_part, add_wire, quaternion
from surg_sim.tasks.pick_and_place.pick_and_place_expert import PegTransferExpert
from surg_sim.tasks.task import State, Task, Verdict

if TYPE_CHECKING:
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

ARM = "PSM1"
RING, MARK = "ring", "goal_mark"
RING_RADIUS, TUBE_RADIUS = 0.009, 0.002
"""Of the ring's middle line and of its tube [m]."""
PEG_RADIUS, PEG_HEIGHT = 0.0015, 0.014
"""[m]"""
BOARD = -0.022
"""Height of the boards' top about the work point [m]."""
_THICK = 0.008  # [m] of a board
_TRAY = BOARD - 0.024  # [m] top of what the boards stand on: below where a ring has fallen off
PEGS = np.array([(side * 0.026, y, BOARD) for side in (-1, 1) for y in (-0.020, 0.0, 0.020)])
"""Feet of the pegs in patient axes about the work point, three on each board, (6, 3) [m]."""

ROUND_PEG = 0.005
"""Largest distance of the ring's centre to the peg's axis [m]; the ring's play is 5.5 mm."""
ON_BOARD = 0.004
"""Largest height of the ring's centre above where it rests [m]."""
FALLEN = 0.015
"""A ring so far below the boards has fallen off them [m]."""
AT_REST = 0.005
"""Largest speed of a ring that lies still [m/s]."""
SETTLE = 0.5
"""So long it must lie still [s]."""

_SEGMENTS = 12
_RING_BIT, _FIXED_BIT = 1 << 17, 1 << 18


class PickAndPlace(Task):
    """See the module."""

    name = "pick_and_place"
    title = "Peg transfer"
    instruction = "Move the ring from its peg to the green peg on the other board."
    stages: ClassVar[Mapping[str, str]] = {
        "grasp": "Grasp the ring on its peg.",
        "carry": "Carry the ring to the green peg and lower it over the peg.",
        "release": "Open the jaws and let the ring rest on the peg.",
    }
    time_limit = 30.0
    home_cell = "sim_ur5e"
    jaws = ARM
    plotted: ClassVar[Mapping[str, str]] = {"held": "0 or 1"}

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """Two boards with pegs, the ring, the pads; what the boards stand on is only seen."""
        self._pegs = np.array([site.place(foot) for foot in PEGS])
        boards = spec.worldbody.add_body(
            name="boards", pos=site.work.tolist(), quat=quaternion(site.R).tolist()
        )
        fixed = {"contype": _FIXED_BIT, "conaffinity": 0, "mass": 0.0, "condim": 3}
        for side in (-1, 1):
            boards.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[side * 0.026, 0.0, BOARD - _THICK / 2],
                size=[0.016, 0.034, _THICK / 2],
                rgba=[0.15, 0.22, 0.30, 1],
                **fixed,
            )
        if visuals:
            _add_tray(boards)
        for foot in PEGS:
            boards.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[*foot, foot[0], foot[1], foot[2] + PEG_HEIGHT - PEG_RADIUS],
                size=[PEG_RADIUS, 0, 0],
                rgba=[0.62, 0.64, 0.66, 1],
                **fixed,
            )
        _add_mark(boards)
        start = site.place(_resting(PEGS[0])).tolist()
        ring = add_part(spec.worldbody, RING, 0.003, [2e-7, 2e-7, 3e-7], pos=start)
        ring.add_freejoint(name=RING)
        angles = np.linspace(0.0, 2.0 * np.pi, _SEGMENTS + 1)
        add_wire(
            ring,
            RING_RADIUS * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles]),
            TUBE_RADIUS,
            rgba=[0.92, 0.45, 0.10, 1],
            contype=_RING_BIT,
            conaffinity=_FIXED_BIT | PAD_BIT,
            condim=3,
            friction=[0.4, 0.005, 0.0001],
        )
        add_rigid_grasp(spec, ARM, self.tip_link, [RING])

    def bind(self, world: World) -> None:
        """Find ring and tip."""
        self._data = world.data
        self._body = int(world.model.body(RING).id)
        joint = world.model.joint(RING)
        self._qpos = slice(int(joint.qposadr[0]), int(joint.qposadr[0]) + 7)
        self._dofs = slice(int(joint.dofadr[0]), int(joint.dofadr[0]) + 6)
        self._mark = [int(world.model.joint(f"{MARK}_{axis}").qposadr[0]) for axis in "xy"]
        self._springs = world.model.qpos_spring
        self.find_tip(world)
        self.grasp = RigidGrasp(world.model, world.data, ARM, self.tip_link, [RING])

    def reset(self, rng: np.random.Generator) -> None:
        """The ring on a peg of one board, a little off its axis; the goal on the other board."""
        super().reset(rng)
        boards = [0, 3] if rng.random() < 0.5 else [3, 0]
        first, last = (int(board + rng.integers(3)) for board in boards)
        self.start, self.goal = self._pegs[first], self._pegs[last]
        self._data.qpos[self._mark] = self._springs[self._mark] = PEGS[last, :2]
        angle, off = rng.uniform(0.0, 2.0 * np.pi), 0.003 * np.sqrt(rng.random())
        turn = rng.uniform(0.0, 2.0 * np.pi)
        place = _resting(self.start) + off * np.array([np.cos(angle), np.sin(angle), 0.0])
        self._data.qpos[self._qpos] = [*place, np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)]
        self._data.qvel[self._dofs] = 0.0
        self.grasp.reset()
        self._still, self._lifted = 0, False

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """One: at the robot."""
        return {"expert": PegTransferExpert(cell, seed, ARM, RING_RADIUS, PEG_HEIGHT)}

    @property
    def ring(self) -> Array:
        """Centre of the ring in the world [m], (3,)."""
        return np.array(self._data.xpos[self._body])

    def advance(self) -> None:
        """The grasp, and how long the ring has been lying."""
        super().advance()
        self.grasp.advance()
        speed = float(np.linalg.norm(self._data.qvel[self._dofs][:3]))
        free = self.grasp.held is None and speed < AT_REST
        self._still = self._still + 1 if free else 0
        self._lifted |= not self._round(self.start) and self.grasp.held is not None

    def _round(self, foot: Array) -> bool:
        """Whether the ring is round a peg, on its board."""
        off = self.ring - _resting(foot)
        return float(np.hypot(off[0], off[1])) < ROUND_PEG and float(off[2]) < ON_BOARD

    def state(self) -> State:
        """Points in the world [m]; ``held`` 0 or 1."""
        return {
            "tip": self.tip,
            "ring": self.ring,
            "ring_velocity": np.array(self._data.qvel[self._dofs][:3]),
            "start": self.start.copy(),
            "goal": self.goal.copy(),
            "held": float(self.grasp.held is not None),
        }

    def verdict(self) -> Verdict:
        """Success, dropped, late, or going on."""
        held = self.grasp.held is not None
        phase = "carry" if held else ("release" if self._lifted else "grasp")
        if self.ring[2] < self._pegs[0][2] - FALLEN:
            return Verdict(done=True, reason="the ring fell off the boards", phase=phase)
        if self._still * TICK >= SETTLE:
            if self._round(self.goal):
                return Verdict(done=True, success=True, reward=1.0, phase="done")
            if not self._round(self.start):
                return Verdict(
                    done=True, reason="the ring was dropped beside the pegs", phase=phase
                )
        return self.late(phase) or Verdict(phase=phase)


def _add_tray(boards: mujoco.MjsBody) -> None:
    """A tray that lies in the tissue bed, and feet on it under the boards."""
    seen = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    box, tray, rim = mujoco.mjtGeom.mjGEOM_BOX, [0.52, 0.55, 0.56, 1], 0.003
    half_x, half_y = 0.054, 0.044
    boards.add_geom(
        type=box, pos=[0, 0, _TRAY - 0.008], size=[half_x, half_y, 0.008], rgba=tray, **seen
    )
    for x, y, size in (
        (half_x - rim, 0.0, [rim, half_y, rim]),
        (0.0, half_y - rim, [half_x, rim, rim]),
    ):
        for side in (-1, 1):
            boards.add_geom(
                type=box, pos=[side * x, side * y, _TRAY + rim], size=size, rgba=tray, **seen
            )
    under = BOARD - _THICK
    for x, y in itertools.product((-0.037, -0.015, 0.015, 0.037), (-0.029, 0.029)):
        boards.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            fromto=[x, y, _TRAY, x, y, under],
            size=[0.0025, 0, 0],
            rgba=[0.08, 0.11, 0.15, 1],
            **seen,
        )


def _add_mark(boards: mujoco.MjsBody) -> None:
    """A green tip on the goal's peg."""
    mark = add_mark(boards, MARK, "xy")
    top = BOARD + PEG_HEIGHT - PEG_RADIUS
    mark.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0, 0, top - 0.006, 0, 0, top],
        size=[PEG_RADIUS + 0.0004, 0, 0],
        rgba=[0.10, 0.80, 0.25, 1],
        contype=0,
        conaffinity=0,
        mass=0.0,
    )


def _resting(foot: Array) -> Array:
    """Centre of a ring that lies round the peg with this foot [m]."""
    return np.asarray(foot + np.array([0.0, 0.0, TUBE_RADIUS]))
