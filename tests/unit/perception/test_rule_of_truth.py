"""What is built and what is believed: cell.yaml and a setting's errors, and calibration/.

MuJoCo's own kinematics says where things are.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers import endoscope_files
from surg_core import base_file, clearance
from surg_core.held_endoscope import held_endoscope
from surg_sim.physics import endoscope_rig
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.patient_settings import PatientSetting, find_setting
from surg_sim.physics.pose_error import PoseError
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

ARM = "ECM"
OFF = np.array([0.003, 0.0, 0.004])
"""5 mm."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return endoscope_files.copied_cell(tmp_path_factory.mktemp("cells"))


@pytest.fixture(scope="module")
def stated(folder: Path) -> surg_core.Cell:
    """The cell without a measured base."""
    return surg_core.load_cell(folder)


@pytest.fixture(scope="module")
def measured(folder: Path, stated: surg_core.Cell) -> surg_core.Cell:
    """The cell with the scope's base measured 5 mm and 3 degrees elsewhere."""
    X_WB = np.array(stated.arms[ARM].X_WB)
    X_WB[:3, 3] += OFF
    X_WB[:3, :3] = surg_core.axis_angle_to_matrix([1, 2, 0], math.radians(3)) @ X_WB[:3, :3]
    first = stated.config.arms[0]
    base = endoscope_files.base(X_WB, first.name, first.base_xyz, first.base_rpy)
    file = folder / "calibration" / f"base_{ARM}.yaml"
    base_file.write_base(file, base, "a test")
    cell = surg_core.load_cell(folder)
    file.unlink()
    return cell


def run_hash(cell: surg_core.Cell, setting: PatientSetting | None = None) -> str:
    world = World(cell, setting=setting)
    for k in range(20):
        world.step({ARM: ArmCommand(velocity=np.full(6, 0.05 * math.sin(0.1 * k)))})
    return world.hash


def test_a_measured_base_moves_what_is_believed_and_not_the_world(
    stated: surg_core.Cell, measured: surg_core.Cell
) -> None:
    before, after = stated.arms[ARM], measured.arms[ARM]
    assert after.X_WB[:3, 3] - before.X_WB[:3, 3] == pytest.approx(OFF, abs=1e-12)
    np.testing.assert_array_equal(after.X_WB_stated, before.X_WB_stated)
    np.testing.assert_array_equal(before.X_WB, before.X_WB_stated)
    np.testing.assert_array_equal(measured.arms["PSM1"].X_WB, stated.arms["PSM1"].X_WB)
    worlds = [World(cell) for cell in (stated, measured)]
    for name in ("xpos", "xquat", "cam_xpos", "site_xpos"):
        np.testing.assert_array_equal(*(getattr(world.data, name) for world in worlds))
    for arm in stated.arms:
        for truth in zip(*(world.truth(arm) for world in worlds), strict=True):
            np.testing.assert_array_equal(*truth)
    assert run_hash(stated) == run_hash(measured)


def test_all_but_the_simulator_believe_the_measurement(
    stated: surg_core.Cell, measured: surg_core.Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    q = np.array(stated.arms[ARM].robot.home)
    views = [held_endoscope(cell).rotation(q) for cell in (stated, measured)]
    turned = surg_core.axis_angle_to_matrix([1, 2, 0], math.radians(3))
    np.testing.assert_allclose(views[1], turned @ views[0], atol=1e-12)
    guarded: list[np.ndarray] = []
    shape = clearance.ArmShape
    monkeypatch.setattr(
        clearance, "ArmShape", lambda *args: guarded.append(np.array(args[2])) or shape(*args)
    )
    for cell in (stated, measured):
        surg_core.clearance_setup(cell, "PSM1")
    assert len(guarded) == 4
    assert guarded[3][:3, 3] - guarded[1][:3, 3] == pytest.approx(OFF, abs=1e-12)


def flange(world: World, cell: surg_core.Cell, arm: str) -> np.ndarray:
    body = world.model.body(f"{arm}_robot_{cell.arms[arm].robot.flange_link}").id
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = world.data.xmat[body].reshape(3, 3), world.data.xpos[body]
    return X


@pytest.mark.parametrize("seed", range(3))
def test_a_settings_error_moves_the_world_and_not_what_is_believed(
    stated: surg_core.Cell, seed: int
) -> None:
    base, camera = PoseError(0.008, math.radians(2), seed), PoseError(0.005, math.radians(4), seed)
    world = World(stated, setting=PatientSetting("test", base_error=base, camera_error=camera))
    exact = World(stated)
    np.testing.assert_array_equal(
        flange(world, stated, "PSM1"), flange(exact, stated, "PSM1"), "the first arm stays"
    )
    arm = stated.arms[ARM]
    np.testing.assert_array_equal(world.cell.arms[ARM].X_WB, arm.X_WB)
    X_BF = np.asarray(arm.chain.forward(arm.robot.home))
    X_WB = flange(world, stated, ARM) @ np.linalg.inv(X_BF)
    D = np.linalg.inv(arm.X_WB) @ X_WB
    assert np.linalg.norm(D[:3, 3]) == pytest.approx(0.008, abs=1e-9)
    assert angle(D) == pytest.approx(math.radians(2), abs=1e-6)
    left, right = (
        EndoscopeView(world.model, world.data, eye).pose
        for eye in (endoscope_rig.LEFT, endoscope_rig.RIGHT)
    )
    drawn, drawn_right = endoscope_rig.camera_poses(arm)
    D = np.linalg.inv(flange(world, stated, ARM) @ drawn) @ left
    assert np.linalg.norm(D[:3, 3]) == pytest.approx(0.005, abs=1e-7)
    assert angle(D) == pytest.approx(math.radians(4), abs=1e-6)
    np.testing.assert_allclose(
        np.linalg.inv(left) @ right, np.linalg.inv(drawn) @ drawn_right, atol=1e-7
    )
    truth = world.truth(ARM)
    assert truth.deviation < 1e-9, "the trocar moves with its arm"
    assert np.linalg.norm(truth.trocar - np.asarray(arm.trocar.p_BRcm)) < 1e-9


def angle(X: np.ndarray) -> float:
    return 2.0 * math.asin(float(np.linalg.norm(X[:3, :3] - np.eye(3))) / math.sqrt(8))


def test_without_an_error_nothing_changes(stated: surg_core.Cell) -> None:
    setting = find_setting("phantom")
    assert run_hash(stated, setting) == run_hash(
        stated, replace(setting, base_error=None, camera_error=PoseError(0.005, 0.05))
    ), "where the camera looks moves nothing"
    model = World(stated).model
    for eye in (endoscope_rig.LEFT, endoscope_rig.RIGHT):
        camera = model.camera(eye)
        np.testing.assert_array_equal(camera.pos, 0.0)
        np.testing.assert_array_equal(np.abs(camera.quat), [0.0, 1.0, 0.0, 0.0])


def test_a_setting_has_variants() -> None:
    found = find_setting("in_vivo+unregistered")
    assert (found.name, found.trocar) == ("in_vivo+unregistered", find_setting("in_vivo").trocar)
    assert (found.base_error.shift, found.camera_error.shift) == (0.008, 0.005)
    assert find_setting("in_vivo").base_error is None
    with pytest.raises(ValueError, match="no variant 'unregistred': there are unregistered"):
        find_setting("phantom+unregistred")
