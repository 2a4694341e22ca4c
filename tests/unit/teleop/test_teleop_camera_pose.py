"""The camera pose that maps the hand: drawn, measured, and while the endoscope moves."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import surg_core
from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import Hand, settings
from surg_cli.host import paths
from surg_core.held_endoscope import held_endoscope
from surg_teleop.follow.teleop_types import CameraView
from surg_teleop.follow.teleoperation import Teleop

TWO_ARMS = paths.ROOT / "cells/sim_two_arms"


def test_the_view_is_the_simulators_camera_wherever_the_endoscope_is() -> None:
    """MuJoCo's own kinematics is the oracle: 50 postures of the endoscope arm."""
    mujoco = pytest.importorskip("mujoco")
    from surg_sim.physics.endoscope_projection import EndoscopeView
    from surg_sim.physics.world import World

    cell = surg_core.load_cell(TWO_ARMS)
    held = held_endoscope(cell)
    world = World(cell)
    view = EndoscopeView(world.model, world.data)
    joints = [
        world.model.joint(f"ECM_robot_{name}").qposadr[0]
        for name in cell.arms["ECM"].robot.joint_names
    ]
    rng = np.random.default_rng(5)
    for _ in range(50):
        q = np.array(cell.arms["ECM"].robot.home) + rng.uniform(-0.6, 0.6, 6)
        world.data.qpos[joints] = q
        mujoco.mj_kinematics(world.model, world.data)
        assert held.rotation(q) == pytest.approx(view.pose[:3, :3], abs=1e-6)


def test_a_measured_camera_replaces_the_drawing(tmp_path: Path) -> None:
    import shutil

    shutil.copytree(paths.ROOT / "cells", tmp_path / "cells")
    for part in ("robots", "instruments", "urdf"):
        shutil.copytree(
            paths.ROOT / "src/surg_description" / part, tmp_path / "src/surg_description" / part
        )
    folder = tmp_path / "cells/sim_two_arms"
    file = folder / "calibration/camera_ECM.yaml"
    drawn = held_endoscope(surg_core.load_cell(folder))
    file.write_text(yaml.safe_dump(CAMERA))
    measured = held_endoscope(surg_core.load_cell(folder))
    assert not np.allclose(measured.R_FV, drawn.R_FV)
    assert pytest.approx(Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()) == measured.R_FV
    file.write_text(yaml.safe_dump({**CAMERA, "n": 2}))
    with pytest.raises(surg_core.ConfigError, match=r"camera_ECM.yaml:\d+: n: 2.0; allowed"):
        held_endoscope(surg_core.load_cell(folder))


CAMERA = {
    "format": "surg_camera/1",
    "quaternion": [0.0, 0.0, 0.6, 0.8],
    "residual": 0.004,
    "n": 15,
    "date": "2026-11-21",
}


def test_a_moving_endoscope_is_applied_exactly_once() -> None:
    """The scope rolls and swings while the hand moves right: the tip moves right in each picture.

    Mapped not at all, or twice, the same run is wrong by more than a third of its way.
    """
    arm, hand = GateArm(), Hand()
    arm.R_WR = Rotation.from_rotvec([0.3, 0.8, -0.4]).as_matrix()
    teleop = Teleop(settings(), scale=1.0)
    teleop.enable()
    right = np.array([1e-4, 0.0, 0.0])
    errors: dict[int, float] = {0: 0.0, 1: 0.0, 2: 0.0}
    for k in range(400):
        now = arm.tick * TICK
        R_WV = Rotation.from_euler("zyx", [0.01 * k, 0.3 * math.sin(0.02 * k), 0.4]).as_matrix()
        if k > 5:
            hand.move(right)
        out = teleop.tick(now, hand.sample(now), arm.view(), CameraView(R_WV))
        before = arm.p
        arm.step(out.commands)
        if k <= 10:
            continue
        moved = arm.p - before
        R_RV = arm.R_WR.T @ R_WV
        for times in errors:
            expected = np.linalg.matrix_power(R_RV, times) @ right
            errors[times] = max(errors[times], float(np.linalg.norm(moved - expected)))
    assert errors[1] < 1e-12
    assert errors[0] > 0.3e-4
    assert errors[2] > 0.3e-4
