"""Clearance between two robots, the operating table and the patient."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import add_arm, robot_part

_TABLE = -0.136  # [m] of the table's top above the work point
_PATIENT = np.array([0.18, 0.27, 0.19])  # [m] half axes of the dome that no link may touch


class ClearanceModel:
    """Two arms, table and patient in one MuJoCo scene, to measure clearances.

    Poses of the bases in the patient's frame, (4, 4).
    """

    def __init__(self, arms: Sequence[surg_core.Arm], bases: Sequence[Array]) -> None:
        spec = mujoco.MjSpec()
        for arm, X_PB in zip(arms, bases, strict=True):
            add_arm(spec, replace(arm, X_WB_stated=X_PB))
        fixed = spec.worldbody
        fixed.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.30, 0.62, 0.05],
                       pos=[0.0, 0.0, _TABLE - 0.05])  # fmt: skip
        fixed.add_geom(name="patient", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                       size=_PATIENT.tolist(), pos=[0.0, 0.0, -0.056])  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._qpos, self._geoms, self._links = [], [], []
        for arm in arms:
            names = [robot_part(arm, name) for name in arm.robot.joint_names]
            self._qpos.append([int(self.model.joint(name).qposadr[0]) for name in names])
            root = self.model.body_rootid[self.model.joint(names[0]).bodyid[0]]
            mount = self.model.body(f"{arm.name}_{arm.instrument.mount_link}").id
            owner = self.model.geom_bodyid
            mine = [g for g in range(self.model.ngeom) if self.model.body_rootid[owner[g]] == root]
            self._geoms.append(mine)
            self._links.append([g for g in mine if owner[g] <= mount])  # bodies are depth first
        self._fixed = [self.model.geom(name).id for name in ("table", "patient")]

    def clearance(self, first: Array, second: Array) -> float:
        """Smallest distance of a robot to the other arm, the table and the patient [m].

        At joint positions of the two arms, (n,) [rad] each. The two shafts inside the patient may
        come arbitrarily close to each other.
        """
        for qpos, q in zip(self._qpos, (first, second), strict=True):
            self.data.qpos[qpos] = q
        mujoco.mj_kinematics(self.model, self.data)
        (a, b), (links_a, links_b) = self._geoms, self._links
        pairs = [*itertools.product(links_a, b), *itertools.product(set(a) - set(links_a), links_b)]
        for links in self._links:
            pairs += list(itertools.product(links, self._fixed))
        return min(self._distance(a, b) for a, b in pairs)

    def _distance(self, a: int, b: int) -> float:
        far = 0.3
        centres = self.data.geom_xpos[a] - self.data.geom_xpos[b]
        reach = self.model.geom_rbound[a] + self.model.geom_rbound[b]
        if np.linalg.norm(centres) > reach + far:
            return far
        return float(mujoco.mj_geomDistance(self.model, self.data, a, b, far, None))
