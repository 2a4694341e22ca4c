"""Where a held endoscope looks: MuJoCo is the oracle of the drawn one, files of a measured one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers import endoscope_files
from surg_core.base_file import write_base
from surg_core.held_endoscope import from_description, held_endoscope, pose_numbers
from surg_core.reading.pose_evidence import file_sha256
from surg_sim.physics import endoscope_rig
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.world import World

ARM = "ECM"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return endoscope_files.copied_cell(tmp_path)


def test_the_pose_is_the_simulators_wherever_the_endoscope_is(folder: Path) -> None:
    """Also from the numbers in a manifest, without the cell's files."""
    cell = surg_core.load_cell(folder)
    held = held_endoscope(cell)
    told = from_description(json.loads(json.dumps(held.describe())))
    world = World(cell)
    eyes = [EndoscopeView(world.model, world.data, eye) for eye in endoscope_rig.FRAMES.values()]
    arm = cell.arms[ARM]
    joints = [world.model.joint(f"{ARM}_robot_{name}").qposadr[0] for name in arm.robot.joint_names]
    postures = np.random.default_rng(2).uniform(-0.6, 0.6, (30, 6)) + np.array(arm.robot.home)
    X_WV = held.poses(postures)
    np.testing.assert_array_equal(told.poses(postures), X_WV)
    numbers = pose_numbers(X_WV)
    for q, X, seven in zip(postures, X_WV, numbers, strict=True):
        world.data.qpos[joints] = q
        mujoco.mj_kinematics(world.model, world.data)
        left, right = (eye.pose for eye in eyes)
        np.testing.assert_allclose(X, left, atol=1e-7)
        np.testing.assert_allclose(held.rotation(q), left[:3, :3], atol=1e-7)
        np.testing.assert_allclose(X @ held.X_LR, right, atol=1e-7)
        np.testing.assert_allclose(seven[:3], left[:3, 3], atol=1e-7)
        turn = Rotation.from_quat(seven[3:]).as_matrix()
        np.testing.assert_allclose(turn, left[:3, :3], atol=1e-7)


def test_a_measured_camera_is_believed_and_a_stale_one_refused(folder: Path) -> None:
    rng = np.random.default_rng(4)
    drawn = held_endoscope(surg_core.load_cell(folder))
    X_FV = drawn.X_FV @ endoscope_files.pose(rng, 0.005)
    calibration = folder / "calibration"
    endoscope_files.write_endoscope(calibration, ARM, X_FV)
    held = held_endoscope(surg_core.load_cell(folder))
    assert (drawn.measured, held.measured) == (False, True)
    np.testing.assert_allclose(held.X_FV, X_FV, atol=1e-12)
    np.testing.assert_allclose(held.X_LR[:3, 3], [0.004, 1e-5, -2e-5], atol=1e-12)
    lens = calibration / "endoscope_left.yaml"
    lens.write_text(lens.read_text() + "# turned the focus ring\n")
    with pytest.raises(surg_core.ConfigError, match=r"left_sha256.*not measured together"):
        held_endoscope(surg_core.load_cell(folder))
    (calibration / "endoscope_stereo.yaml").unlink()
    with pytest.raises(surg_core.ConfigError, match=r"camera_ECM.yaml: left_sha256.*handeye"):
        held_endoscope(surg_core.load_cell(folder))


def test_a_base_seen_through_an_older_camera_is_refused(folder: Path) -> None:
    calibration, cell = folder / "calibration", surg_core.load_cell(folder)
    names = list(cell.arms)
    stated = cell.config.arms[0]
    endoscope_files.write_endoscope(calibration, ARM)
    camera = calibration / f"camera_{ARM}.yaml"
    base = endoscope_files.base(
        cell.arms[names[1]].X_WB_stated, names[0], stated.base_xyz, stated.base_rpy
    )
    seen = replace(base, camera_sha256=file_sha256(camera))
    file = calibration / f"base_{names[1]}.yaml"
    write_base(file, seen, "made up")
    assert held_endoscope(surg_core.load_cell(folder)) is not None
    endoscope_files.write_endoscope(calibration, ARM, seed=1)
    stale = rf"{file.name}: camera_sha256: .*{camera.name}.*Repeat ./surg calibrate CELL bases"
    with pytest.raises(surg_core.ConfigError, match=stale):
        held_endoscope(surg_core.load_cell(folder))
    camera.unlink()
    with pytest.raises(surg_core.ConfigError, match="no such file"):
        held_endoscope(surg_core.load_cell(folder))
    write_base(file, base, "made up")  # no camera had a part in it
    assert held_endoscope(surg_core.load_cell(folder)) is not None


def test_a_rotation_alone_gives_no_pose(folder: Path) -> None:
    (folder / f"calibration/camera_{ARM}.yaml").write_text(
        "format: surg_camera/1\nquaternion: [0, 0, 0.6, 0.8]\nresidual: 0.004\nn: 15\n"
        "date: 2026-11-21\n"
    )
    cell = surg_core.load_cell(folder)
    held = held_endoscope(cell)
    assert held.rotation(cell.arms[ARM].robot.home).shape == (3, 3)
    with pytest.raises(surg_core.ConfigError, match="rotation only"):
        held.poses(np.zeros((1, 6)))


def test_a_broken_description_is_refused(folder: Path) -> None:
    good = held_endoscope(surg_core.load_cell(folder)).describe()
    for key, value in (("X_WB", [[1.0]]), ("joints", [{}]), ("X_FV", "here"), ("R_FV", None)):
        with pytest.raises(surg_core.ConfigError, match="endoscope: "):
            from_description({**good, key: value})
    with pytest.raises(surg_core.ConfigError):
        from_description({})
