"""The clearance guard knows a bent wrist: judged by MuJoCo's distances to what is drawn of it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths
from surg_sim.physics.sim_arm import add_arm, robot_part
from surg_sim.physics.tool_drive import WRIST_JOINTS

Array = NDArray[np.float64]
POSES = 2000
NEAR = 0.05
"""[m] from the tip: as far as the drawn points lie."""
TIGHT = 0.006
"""[m] The guard's shape may reach no farther beyond the tip where the wrist is bent most."""


def points_to_capsules(p: Array, rows: Array) -> float:
    """Distance of a point (3,) to capsules (n, 7): ends and radius [m]."""
    a, along = rows[:, :3], rows[:, 3:6] - rows[:, :3]
    length2 = np.maximum(np.einsum("ij,ij->i", along, along), 1e-18)
    t = np.clip(np.einsum("ij,ij->i", p - a, along) / length2, 0.0, 1.0)
    return float((np.linalg.norm(p - a - t[:, None] * along, axis=1) - rows[:, 6]).min())


@pytest.mark.parametrize("name", ["sim_ur5e_wrist", "sim_panda_wrist"])
def test_nothing_is_nearer_to_a_bent_wrist_than_the_guard_thinks(name: str) -> None:
    arm = surg_core.load_cell(paths.ROOT / "cells" / name).arms["PSM1"]
    shape = surg_core.ArmShape(arm.name, arm.chain, arm.X_WB, arm.robot, arm.instrument, arm.tool)
    assert [c.name for c in shape.capsules if c.shaft] == ["wrist", "shaft"]
    spec = mujoco.MjSpec()
    add_arm(spec, arm)
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0.0, 0.0])
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [robot_part(arm, joint) for joint in arm.robot.joint_names]
    joints += [f"{arm.name}_{joint}" for joint in WRIST_JOINTS]
    qpos = [int(model.joint(joint).qposadr[0]) for joint in joints]
    behind = int(model.body(f"{arm.name}_wrist").id)  # bodies are depth first
    distal = [g for g in range(model.ngeom) if model.geom_bodyid[g] >= behind]
    tip, ball = int(model.body(f"{arm.name}_tip").id), model.geom("probe").id
    wrist, rng = arm.instrument.wrist, np.random.default_rng(5)
    assert wrist is not None and len(distal) > 5
    reserve = []
    for _ in range(POSES):
        q = np.asarray(arm.robot.home) + rng.normal(0.0, 0.4, arm.chain.dof)
        data.qpos[qpos] = [*q, *rng.uniform(wrist.min, wrist.max)]
        mujoco.mj_kinematics(model, data)
        data.mocap_pos[0] = data.xpos[tip] + rng.uniform(-NEAR, NEAR, 3)
        mujoco.mj_kinematics(model, data)
        true = 1e-4 + min(
            mujoco.mj_geomDistance(model, data, geom, ball, 1.0, None)
            for geom in distal
            if geom != ball
        )
        reserve.append(true - points_to_capsules(data.mocap_pos[0], shape.placed(q)))
    print(f"{name}: the guard keeps {1e3 * min(reserve):.2f} to {1e3 * max(reserve):.2f} mm more")
    assert 0.0 <= min(reserve) < TIGHT
