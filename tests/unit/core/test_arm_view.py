"""What an arm reports, in the trocar frame; a pose as quaternion and as joints."""

from __future__ import annotations

import numpy as np
import pytest

import surg_core
from surg_core.arm_view import ArmCommands, ArmState, ArmView, TipPose


def view(**changes: object) -> ArmView:
    values: dict[str, object] = {
        "stamp_ns": 0,
        "state": ArmState.ENABLED,
        "homed": True,
        "busy": False,
        "reason": "",
        "refused": 0,
        "p_BTip": np.zeros(3),
        "p_BSet": np.zeros(3),
    }
    return ArmView(**{**values, **changes})  # type: ignore[arg-type]


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    return surg_core.quaternion_xyzw_to_matrix(rng.normal(size=4))


def test_tip_and_set_point_are_where_the_trocar_frame_has_them() -> None:
    rng = np.random.default_rng(1)
    for _ in range(1000):
        R_BR, R_WB, p_BRcm = random_rotation(rng), random_rotation(rng), rng.normal(size=3)
        p_tip, p_set = rng.normal(size=(2, 3))
        seen = view(
            p_BTip=p_BRcm + R_BR @ p_tip,
            p_BSet=p_BRcm + R_BR @ p_set,
            p_BRcm=p_BRcm,
            R_BR=R_BR,
            R_WB=R_WB,
        )
        np.testing.assert_allclose(seen.p_tip, p_tip, atol=1e-12)
        np.testing.assert_allclose(seen.p_set, p_set, atol=1e-12)
        np.testing.assert_allclose(seen.R_WR, R_WB @ R_BR)


def test_without_a_trocar_frame_nothing_is_said_in_it() -> None:
    for name in ("p_tip", "p_set", "R_WR"):
        with pytest.raises(ValueError):
            getattr(view(), name)


def test_ready_means_homed_and_enabled() -> None:
    ready = [
        (state, homed)
        for state in (ArmState.DISABLED, ArmState.ENABLED, ArmState.PAUSED, ArmState.FAULT)
        for homed in (False, True)
        if view(state=state, homed=homed).ready
    ]
    assert ready == [(ArmState.ENABLED, True)]


def test_quaternion_and_joints_of_a_pose_agree() -> None:
    rng = np.random.default_rng(2)
    for _ in range(1000):
        p = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.02, 0.2)])
        roll = float(rng.uniform(-np.pi, np.pi))
        pose = TipPose(p, roll)
        R = surg_core.quaternion_xyzw_to_matrix(pose.q)
        np.testing.assert_allclose(R[:, 2], p / np.linalg.norm(p), atol=1e-12)
        yaw, pitch, insertion, joint_roll = pose.joints
        s = [np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)]
        np.testing.assert_allclose(insertion * np.array(s), p, atol=1e-12)
        assert joint_roll == roll


def test_commands_are_true_where_there_is_something_to_send() -> None:
    pose = TipPose(np.array([0.0, 0.0, 0.1]), 0.0)
    assert not ArmCommands(stamp_ns=3)
    for member in (
        {"state": "home"}, {"claim": True}, {"hold": True}, {"move_cp": pose}, {"jaw": 0.0},
        {"servo_cp": pose}, {"servo_jp": np.zeros(4)},
    ):  # fmt: skip
        assert ArmCommands(**member)  # type: ignore[arg-type]
