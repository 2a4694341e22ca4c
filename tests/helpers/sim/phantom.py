"""Arm, bowel and assistant in one scene, without a controller: for the tissue's tests."""

from __future__ import annotations

import functools
import hashlib

import mujoco
import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.sim.assistant_pose import forward, joints_for
from surg_cli.host import paths
from surg_sim.appearance.tissue_skin import add_skin
from surg_sim.physics import scene
from surg_sim.physics.assistant_arm import Assistant, AssistantCommand
from surg_sim.physics.assistant_scene import add_assistant
from surg_sim.physics.bowel import Bowel
from surg_sim.physics.sim_arm import SUBSTEPS, ArmLink
from surg_sim.physics.tissue import TissueParameters, add_bowel
from surg_sim.physics.tissue_grasp import GRIP_DEPTH, Grasp, add_grasp

Array = NDArray[np.float64]

OPEN, SHUT = 0.6, 0.0
"""Jaw angles [rad]."""


@functools.cache
def arm_of(cell: str) -> surg_core.Arm:
    """The instrument arm of a bundled cell."""
    return surg_core.load_cell(paths.ROOT / "cells" / cell).arms["PSM1"]


@functools.cache
def compiled(cell: str, parameters: TissueParameters, visuals: bool) -> mujoco.MjModel:
    """The scene of this helper, compiled once per process; ``Phantom`` works on copies."""
    arm = arm_of(cell)

    def add(spec: mujoco.MjSpec, site: scene.Site) -> None:
        add_bowel(spec, site, parameters)
        if visuals:
            add_skin(spec, site, parameters)
        add_assistant(spec, site, arm.instrument_urdf, visuals)
        add_grasp(spec, "PSM1")
        add_grasp(spec, "assistant")

    return scene.build([arm], visuals=visuals, add=add)


class Phantom:
    """The scene of a bundled cell with bowel and assistant; the robot stands still.

    Args:
        cell: Name of the cell.
        parameters: Of the tissue.
        visuals: Whether the scene can be drawn.
    """

    def __init__(
        self,
        cell: str = "sim_ur5e",
        parameters: TissueParameters | None = None,
        visuals: bool = False,
    ) -> None:
        import copy

        arm, parameters = arm_of(cell), parameters or TissueParameters()
        self.model = copy.copy(compiled(cell, parameters, visuals))
        self.data = mujoco.MjData(self.model)
        self.site = scene.site_of([arm])
        self.link = ArmLink(self.model, self.data, arm)
        self.bowel = Bowel(self.model, self.data, self.site, parameters)
        self.assistant = Assistant(self.model, self.data)
        self.grasp = Grasp(self.model, self.data, "assistant", self.bowel)
        self.robot_grasp = Grasp(self.model, self.data, "PSM1", self.bowel)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """All at rest; the bowel in a shape drawn with this seed, or the plain one."""
        mujoco.mj_resetData(self.model, self.data)
        self.link.reset()
        self.bowel.reset(None if seed is None else np.random.default_rng(seed))
        self.assistant.reset()
        self.grasp.reset()
        self.robot_grasp.reset()
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_step1(self.model, self.data)
        self._hash = hashlib.sha256()

    def run(self, ticks: int, joints: Array | None = None, jaw: float | None = None) -> None:
        """Let time pass; the assistant is told once, at the beginning."""
        self.assistant.accept(AssistantCommand(joints, jaw))
        for _ in range(ticks):
            self.bowel.advance()
            self.grasp.advance()
            self.robot_grasp.advance()
            self.assistant.advance()
            for _ in range(SUBSTEPS):
                mujoco.mj_step2(self.model, self.data)
                mujoco.mj_step1(self.model, self.data)
            self._hash.update(self.data.qpos.tobytes() + self.data.qvel.tobytes())

    @property
    def hash(self) -> str:
        """Of all states since the reset."""
        return self._hash.hexdigest()

    @property
    def warnings(self) -> int:
        """MuJoCo's warnings since the reset."""
        return int(sum(w.number for w in self.data.warning))

    def across(self, node: int) -> float:
        """Roll of the assistant with which its jaws close across the tube at a node [rad]."""
        nodes = self.bowel.nodes
        along = nodes[min(node + 1, len(nodes) - 1)] - nodes[max(node - 1, 0)]
        X = self.assistant.X_WRcm[:3, :3] @ forward(joints_for(self.assistant, nodes[node]))[:3, :3]
        local = X.T @ along
        roll = float(np.arctan2(local[1], local[0]))
        return (roll + np.pi / 2) % np.pi - np.pi / 2

    def shaft(self, p_W: Array) -> Array:
        """Direction of the assistant's shaft when its tip is at a point, world, (3,)."""
        d = p_W - self.assistant.X_WRcm[:3, 3]
        return np.asarray(d / np.linalg.norm(d))

    def go(self, p_W: Array, roll: float = 0.0, jaw: float | None = None, ticks: int = 300) -> None:
        """Bring the assistant's tip to a point in the world."""
        self.run(ticks, joints_for(self.assistant, p_W, roll), jaw)

    def approach(self, node: int, aside: float = 0.0, depth: float = GRIP_DEPTH) -> float:
        """Open the jaws and bring them round a node; returns the roll.

        Args:
            node: Where.
            aside: Displacement across the tube, along the jaws' opening [m].
            depth: Of the tip beyond the tube's axis [m]; by default the grip is on it.
        """
        place, roll = self.bowel.nodes[node], self.across(node)
        shaft = self.shaft(place)
        X = self.assistant.X_WRcm[:3, :3] @ forward(joints_for(self.assistant, place, roll))[:3, :3]
        place = place + aside * X[:, 1]
        self.go(place - 0.03 * shaft, roll, OPEN)
        self.go(place + depth * shaft, roll, OPEN, 150)
        return roll

    def take(self, node: int) -> float:
        """Grasp at a node; returns the roll."""
        roll = self.approach(node)
        self.run(200, jaw=SHUT)
        return roll
