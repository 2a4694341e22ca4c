"""Planned tips in the picture, against OpenCV's projection and the simulator's own camera."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.endoscope_files import lens
from surg_cli.host import paths
from surg_core.held_endoscope import held_endoscope
from surg_core.lens_file import Lens
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.pictures.plan_projection import plan_pixels, rcm_in_world
from surg_sim.physics.world import World


def pose(rng: np.random.Generator, spread: float = 0.3) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(0, spread, 3)
    return X


@pytest.mark.parametrize("seed", range(20))
def test_a_plan_lies_where_opencv_projects_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X_WB, X_WV = pose(rng), pose(rng)
    R_BR, p_BRcm = Rotation.random(random_state=rng), rng.normal(0, 0.2, 3)
    # Tips before the eye, put into the rcm frame by other code.
    seen = rng.uniform([-0.02, -0.015, 0.06], [0.02, 0.015, 0.12], (12, 3))
    in_world = Rotation.from_matrix(X_WV[:3, :3]).apply(seen) + X_WV[:3, 3]
    in_base = Rotation.from_matrix(X_WB[:3, :3]).inv().apply(in_world - X_WB[:3, 3])
    p_R = R_BR.inv().apply(in_base - p_BRcm)
    made = lens("left")
    found = plan_pixels(
        p_R, rcm_in_world(X_WB, R_BR.as_quat(), p_BRcm), X_WV, EyeProjection(made, np.eye(4))
    )
    expected, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), made.K, made.D)
    assert made.D.any()
    np.testing.assert_allclose(found, expected[:, 0], atol=1e-6)


def test_what_the_eye_cannot_see_has_no_pixel() -> None:
    p_R = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.1], [0.0, 0.0, 0.001]])
    found = plan_pixels(p_R, np.eye(4), np.eye(4), EyeProjection(lens("left"), np.eye(4)))
    assert np.isfinite(found).all(axis=1).tolist() == [True, False, False]


def test_a_plan_lies_where_the_simulators_camera_sees_the_tip() -> None:
    """MuJoCo's bodies and camera: it looks along -z, with y up."""
    cell = surg_core.load_cell(paths.CELLS / "sim_two_arms")
    world = World(cell, 0, visuals=True)
    rng, (width, height) = np.random.default_rng(3), (640, 480)
    held, arm = held_endoscope(cell), cell.arms["PSM1"]
    assert held is not None
    f = height / 2 / np.tan(np.radians(world.model.camera("endoscope_left").fovy[0]) / 2)
    K = np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])
    flat = Lens(width, height, "left", K, "plumb_bob", np.zeros(5), np.eye(3), np.eye(3, 4))
    X_BR = pose(rng)
    q_BR = Rotation.from_matrix(X_BR[:3, :3]).as_quat()
    q = {name: np.array(each.robot.home) for name, each in cell.arms.items()}
    seen = []
    for _ in range(5):
        for name, home in q.items():
            for joint, value in zip(cell.arms[name].robot.joint_names, home, strict=True):
                turned = value + rng.normal(0, 0.003)
                world.data.joint(f"{name}_robot_{joint}").qpos[0] = turned
        mujoco.mj_kinematics(world.model, world.data)
        mujoco.mj_camlight(world.model, world.data)
        angles = {
            name: np.array(
                [world.data.joint(f"{name}_robot_{j}").qpos[0] for j in each.robot.joint_names]
            )
            for name, each in cell.arms.items()
        }
        camera = world.data.camera("endoscope_left")
        away = camera.xmat.reshape(3, 3).T @ (world.data.body("PSM1_tip").xpos - camera.xpos)
        expected = K[:2, 2] + f * np.array([away[0], -away[1]]) / -away[2]
        X_BF = np.asarray(arm.chain.forward(angles["PSM1"]))
        p_B = X_BF @ np.append(np.asarray(arm.tool.p_FTip), 1.0)
        p_R = (np.linalg.inv(X_BR) @ p_B)[:3]
        X_WV = held.poses(angles[held.arm][None])[0]
        X_WR = rcm_in_world(np.asarray(arm.X_WB), q_BR, X_BR[:3, 3])
        found = plan_pixels(p_R[None], X_WR, X_WV, EyeProjection(flat, np.eye(4)))[0]
        np.testing.assert_allclose(found, expected, atol=0.05)  # bodies are stored as float32
        seen.append(found)
    assert np.ptp(seen, axis=0).min() > 0.5, "they moved"
