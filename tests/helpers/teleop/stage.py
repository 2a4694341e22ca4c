"""A stereo endoscope and an instrument put anywhere, and what the endoscope then sees.

Kinematics and pictures only: the arms are put by inverse kinematics with their shafts through their
trocars, so that hundreds of views cost little more than their pictures.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.render import Picture, Renderer, show_only
from surg_sim.physics import endoscope_rig, scene
from surg_sim.physics.trocar import shaft_in_flange, wall_frame
from surg_sim.physics.world import World
from surg_sim.placement.arm_reserve import inverse

Array = NDArray[np.float64]


def turn(axis: Array, angle: float) -> Array:
    """Rotation by an angle about a unit axis, (3, 3)."""
    return np.asarray(surg_core.axis_angle_to_matrix(np.asarray(axis, dtype=float), angle))


def between(a: Array, b: Array) -> Array:
    """The smallest rotation that carries unit vector a to b, (3, 3)."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    return np.eye(3) if sine < 1e-12 else turn(axis / sine, float(np.arctan2(sine, a @ b)))


@dataclass
class _Held:
    """What an arm holds, and how it is put somewhere."""

    arm: surg_core.Arm
    pivot: Array
    p_FTip: Array
    s_W: Array
    R_WF: Array
    depth: float
    q: Array


class Stage:
    """The cell ``sim_two_arms``, or another with an instrument and a stereo endoscope.

    Args:
        cell: A loaded cell.
        width: Of each picture [px].
        height: Of each picture [px].
    """

    def __init__(self, cell: surg_core.Cell, width: int = 640, height: int = 480) -> None:
        self.cell = cell
        self.world = World(cell, visuals=True)
        show_only(self.world.model, lamps=False)
        try:
            eyes = [endoscope_rig.LEFT, endoscope_rig.RIGHT]
            self.renderer = Renderer(
                self.world.model, eyes, width, height, vignette=True, hidden=[OUTSIDE]
            )
        except NoOpenGL as error:
            pytest.skip(str(error))
        arms = list(cell.arms.values())
        scope = endoscope_rig.holder(arms)
        assert scope is not None
        self.work = scene.site_of(arms).work
        self.scope, self.tool = scope.name, next(a.name for a in arms if a is not scope)
        self._held = {arm.name: self._hold(arm) for arm in arms}

    def _hold(self, arm: surg_core.Arm) -> _Held:
        pivot, s_W = wall_frame(arm)
        p_FTip, _ = shaft_in_flange(arm)
        q = np.array(arm.robot.home)
        X_WF = np.asarray(arm.X_WB) @ np.asarray(arm.chain.forward(q))
        depth = float(s_W @ (X_WF[:3, :3] @ p_FTip + X_WF[:3, 3] - pivot))
        return _Held(arm, pivot, p_FTip, s_W, X_WF[:3, :3], depth, q)

    def put(self, name: str, tip: Array, roll: float = 0.0) -> bool:
        """Put an arm's tip somewhere, its shaft through its trocar.

        Args:
            name: Of the arm.
            tip: (3,) in the world [m].
            roll: About the shaft, from home [rad].

        Returns:
            Whether the arm reaches it; if not, it stays.
        """
        held = self._held[name]
        arm, way = held.arm, tip - held.pivot
        depth = float(np.linalg.norm(way))
        R_WF = between(held.s_W, way / depth) @ turn(held.s_W, roll) @ held.R_WF
        X_WF = np.eye(4)
        X_WF[:3, :3], X_WF[:3, 3] = R_WF, tip - R_WF @ held.p_FTip
        q = inverse(arm.chain, held.q, np.linalg.inv(arm.X_WB) @ X_WF)
        if q is None or np.any(q < arm.robot.position_min) or np.any(q > arm.robot.position_max):
            return False
        held.q = q
        model, data = self.world.model, self.world.data
        for joint, angle in zip(arm.robot.joint_names, q, strict=True):
            data.qpos[model.joint(f"{name}_robot_{joint}").qposadr[0]] = angle
        data.qpos[model.joint(f"{name}/sleeve").qposadr[0]] = held.depth - depth
        return True

    def pivot(self, name: str) -> Array:
        """(3,) trocar point of an arm in the world [m]."""
        return self._held[name].pivot

    def shaft(self, name: str) -> Array:
        """(3,) shaft axis of an arm at home in the world, into the patient."""
        return self._held[name].s_W

    def joints(self, name: str) -> Array:
        """(n,) joint positions of an arm [rad]."""
        return np.array(self._held[name].q)

    def aim(self, rng: np.random.Generator, spread: float = 0.12) -> None:
        """A view drawn at random: any roll, any distance, the work point somewhere in its middle.

        Args:
            rng: Draws it.
            spread: Largest angle between view and work point [rad].
        """
        held = self._held[self.scope]
        for _ in range(50):
            look = self.work - held.pivot
            look /= np.linalg.norm(look)
            axis = np.cross(look, rng.normal(size=3))
            s = turn(axis / np.linalg.norm(axis), rng.uniform(0.0, spread)) @ look
            tip = held.pivot + rng.uniform(0.040, 0.080) * s
            if self.put(self.scope, tip, rng.uniform(-np.pi, np.pi)):
                return
        raise AssertionError("no view could be reached")

    def pictures(self) -> tuple[Picture, Picture]:
        """What both eyes see now."""
        left, right = self.renderer.render(np.array(self.world.data.qpos))
        return left, right

    def X_WV(self) -> Array:
        """True pose of the left eye's optical frame in the world, (4, 4); after ``pictures``."""
        return self.renderer.camera_pose()

    def pixel(self, point: Array) -> Array:
        """Where a point of the world is in the left picture: for the test's own arithmetic."""
        X = self.X_WV()
        return self.renderer.intrinsics.project(X[:3, :3].T @ (point - X[:3, 3]))


@functools.cache
def stage_of(cell: str) -> Stage:
    """The stage of a bundled cell, made once per process: it costs more than many pictures."""
    return Stage(surg_core.load_cell(paths.CELLS / cell))
