"""The core's chain beside the simulator's arm: two programs that compute the same kinematics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

import surg_core
from surg_sim.physics.sim_arm import add_arm, robot_part


@dataclass(frozen=True)
class Difference:
    """Largest difference between the core's chain and MuJoCo over drawn postures."""

    position: float  # [m]
    angle: float  # [rad]
    postures: int


def compare(arm: surg_core.Arm, postures: int = 200, seed: int = 0) -> Difference:
    """Compare ``arm.chain`` with the simulator's arm over postures inside the joint limits.

    Raises:
        ValueError: MuJoCo refuses the URDF.
    """
    spec = mujoco.MjSpec()
    add_arm(spec, arm)
    model = spec.compile()
    data = mujoco.MjData(model)
    robot = arm.robot
    places = [model.joint(robot_part(arm, name)).qposadr[0] for name in robot.joint_names]
    flange = data.body(robot_part(arm, robot.flange_link))
    rng = np.random.default_rng(seed)
    position = angle = 0.0
    for _ in range(postures):
        q = rng.uniform(robot.position_min, robot.position_max)
        data.qpos[places] = q
        mujoco.mj_kinematics(model, data)
        X = arm.X_WB_stated @ arm.chain.forward(q)
        position = max(position, float(np.linalg.norm(flange.xpos - X[:3, 3])))
        turn = flange.xmat.reshape(3, 3) @ X[:3, :3].T
        # The sine: near 0 the cosine of an angle has half of its digits only.
        sine = float(np.linalg.norm(turn - turn.T)) / math.sqrt(8.0)
        angle = max(angle, math.atan2(sine, (float(np.trace(turn)) - 1.0) / 2.0))
    return Difference(position, angle, postures)
