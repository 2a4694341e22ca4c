"""Two arms and obstacles as capsules in MuJoCo: the oracle for the clearance guard's distances.

MuJoCo moves the capsules by its own kinematics of the URDF and measures the distances by its own
geometry. The capsules are taken from the YAML files, the shaft from the instrument's YAML.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_sim.physics.sim_arm import add_arm, robot_part

Array = NDArray[np.float64]
FAR = 0.5  # [m] beyond which nobody looks


class CapsuleScene:
    """Distances of arms to each other and to obstacles.

    Args:
        arms: The arms.
        obstacles: Of the cell.
    """

    def __init__(
        self, arms: Sequence[surg_core.Arm], obstacles: Sequence[surg_core.Obstacle] = ()
    ) -> None:
        spec = mujoco.MjSpec()
        owner: list[tuple[int, bool, bool]] = []  # of a capsule: arm, it moves, it is the shaft
        names: list[str] = []
        for index, arm in enumerate(arms):
            add_arm(spec, arm)
            joints = [robot_part(arm, name) for name in arm.robot.joint_names]
            links = {i: spec.joint(name).parent for i, name in enumerate(joints)}
            links[-1] = spec.body(robot_part(arm, arm.robot.base_link))
            mount = spec.body(f"{arm.name}_{arm.instrument.mount_link}")
            parts = [(links[c.joint], c) for c in arm.robot.capsules]
            parts += [(mount, c) for c in arm.instrument.capsules]
            for body, capsule in parts:
                names.append(f"capsule{len(names)}")
                _add_capsule(body, names[-1], capsule)
                owner.append((index, body != links[-1], capsule.shaft))
        for obstacle in obstacles:
            names.append(f"capsule{len(names)}")
            if obstacle.half_space:
                _add_half_space(spec.worldbody, names[-1], obstacle)
            else:
                _add_capsule(spec.worldbody, names[-1], obstacle)
            owner.append((-1, False, False))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._qpos = [
            [
                int(self.model.joint(robot_part(arm, name)).qposadr[0])
                for name in arm.robot.joint_names
            ]
            for arm in arms
        ]
        geoms = [self.model.geom(name).id for name in names]
        pairs = [
            (geoms[i], geoms[k])
            for i, (arm, moves, shaft) in enumerate(owner)
            for k, (other, other_moves, other_shaft) in enumerate(owner)
            if arm != other and (moves or other_moves)
            if (i < k if other >= 0 and arm >= 0 else arm >= 0 and moves and not shaft)
            if not (shaft and other_shaft)
        ]
        self._first, self._second = np.array(pairs).T
        self._reach = self.model.geom_rbound[self._first] + self.model.geom_rbound[self._second]

    def distance(self, *postures: Array) -> float:
        """Smallest distance at joint positions of the arms, (n,) [rad] each [m]; at most FAR."""
        for qpos, q in zip(self._qpos, postures, strict=True):
            self.data.qpos[qpos] = q
        mujoco.mj_kinematics(self.model, self.data)
        centres = self.data.geom_xpos[self._first] - self.data.geom_xpos[self._second]
        least = np.sqrt(np.einsum("ij,ij->i", centres, centres)) - self._reach
        best = FAR
        for i in np.argsort(least):
            if least[i] >= best:
                break
            a, b = int(self._first[i]), int(self._second[i])
            best = min(best, mujoco.mj_geomDistance(self.model, self.data, a, b, best, None))
        return float(best)


def _add_capsule(body: mujoco.MjsBody, name: str, shape: object) -> None:
    a, b, radius = np.asarray(shape.a), np.asarray(shape.b), shape.radius  # type: ignore[attr-defined]
    if np.linalg.norm(b - a) < 1e-9:
        kind, size, ends = mujoco.mjtGeom.mjGEOM_SPHERE, [radius, 0.0, 0.0], {"pos": a}
    else:
        kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, [radius, 0.0, 0.0]
        ends = {"fromto": np.concatenate([a, b])}
    body.add_geom(name=name, type=kind, size=size, contype=0, conaffinity=0, mass=0.0, **ends)


def _add_half_space(body: mujoco.MjsBody, name: str, space: surg_core.Obstacle) -> None:
    """A box of 4 m: MuJoCo measures no distances to planes."""
    normal, quat = np.asarray(space.b), np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, normal)
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[4.0, 4.0, 1.0], quat=quat,
                  pos=np.asarray(space.a) - normal, contype=0, conaffinity=0)  # fmt: skip
