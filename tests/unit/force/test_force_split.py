"""Forces at tip and trocar from a wrench at the flange, against statics and MuJoCo's sensors."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from helpers.force.statics import Array, Situation, drawn, turn
from surg_core.force.compensation import (
    ToolLoad,
    external_jacobian,
    external_wrench,
    moved,
)
from surg_core.force.split import pivot_jacobian, split, split_matrix

CASES = 150


def load_of(case: Situation) -> ToolLoad:
    return ToolLoad(case.mass, case.p_SCom, case.bias, case.R_FS, case.p_FS, np.zeros((13, 13)))


def about_trocar(case: Situation, reading: Array, load: ToolLoad) -> Array:
    """The wrench from outside about the trocar's point on the shaft."""
    origin = case.X_BF[:3, 3] + case.X_BF[:3, :3] @ case.p_FS
    return moved(external_wrench(load, reading, case.X_BF[:3, :3], case.g), origin - case.p_Rcm)


def test_both_lateral_forces_and_the_axial_sum_of_drawn_tools_are_exact() -> None:
    rng = np.random.default_rng(1)
    for _ in range(CASES):
        case = drawn(rng)
        found = split(about_trocar(case, case.reading(), load_of(case)), case.s, case.depth)
        np.testing.assert_allclose(found.tip, case.across(case.tip), atol=1e-9)
        np.testing.assert_allclose(found.trocar, case.across(case.trocar), atol=1e-9)
        assert found.axial == pytest.approx(case.s @ (case.tip + case.trocar), abs=1e-10)
        assert found.twist == pytest.approx(0.0, abs=1e-10)


def test_axial_forces_of_tip_and_trocar_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        case = drawn(rng)
        before = split(about_trocar(case, case.reading(), load_of(case)), case.s, case.depth)
        case.tip, case.trocar = case.tip + 3.0 * case.s, case.trocar - 3.0 * case.s
        after = split(about_trocar(case, case.reading(), load_of(case)), case.s, case.depth)
        np.testing.assert_allclose(after.tip, before.tip, atol=1e-9)
        assert after.axial == pytest.approx(before.axial, abs=1e-10)


def test_mujocos_force_and_torque_sensors_read_the_same_tool() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        case = drawn(rng)
        R_BS = case.X_BF[:3, :3] @ case.R_FS
        quat, origin = np.zeros(4), case.X_BF[:3, 3] + case.X_BF[:3, :3] @ case.p_FS
        mujoco.mju_mat2Quat(quat, R_BS.ravel())
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><option gravity="{" ".join(map(str, case.g))}"/><worldbody>
            <body name="tool" pos="{" ".join(map(str, origin))}"
                  quat="{" ".join(map(str, quat))}"><site name="s"/>
            <inertial pos="{" ".join(map(str, case.p_SCom))}" mass="{case.mass}"
                      diaginertia="0.001 0.001 0.001"/></body></worldbody>
            <sensor><force site="s"/><torque site="s"/></sensor></mujoco>"""
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        com = data.xipos[1]
        for point, force in ((case.p_Tip, case.tip), (case.p_Rcm, case.trocar)):
            data.xfrc_applied[1, :3] += force
            data.xfrc_applied[1, 3:] += np.cross(point - com, force)
        mujoco.mj_forward(model, data)
        # MuJoCo states what the parent exerts on the child; a reading is the opposite.
        reading = case.bias - data.sensordata
        found = split(about_trocar(case, reading, load_of(case)), case.s, case.depth)
        np.testing.assert_allclose(found.tip, case.across(case.tip), atol=1e-7)
        np.testing.assert_allclose(found.trocar, case.across(case.trocar), atol=1e-7)


@pytest.mark.parametrize("seed", range(10))
def test_derivatives_by_load_reading_and_trocar_are_finite_differences(seed: int) -> None:
    case = drawn(np.random.default_rng(seed))
    load, reading, R = load_of(case), case.reading(), case.X_BF[:3, :3]

    def changed(d: Array) -> Array:
        other = ToolLoad(
            load.mass + d[0], load.p_SCom + d[1:4], load.bias + d[4:10],
            load.R_FS @ turn(d[10:]), load.p_FS, load.covariance,
        )  # fmt: skip
        return external_wrench(other, reading, R, case.g)

    numeric = differences(changed, 13)
    np.testing.assert_allclose(external_jacobian(load, reading, R, case.g), numeric, atol=1e-6)

    wrench = about_trocar(case, reading, load)
    found = split(wrench, case.s, case.depth)
    stacked = np.concatenate([found.tip, found.trocar, [found.axial]])
    np.testing.assert_allclose(split_matrix(case.s, case.depth) @ wrench, stacked, atol=1e-9)

    def with_trocar_at(d: Array) -> Array:
        there = split(moved(wrench, -d), case.s, case.depth - case.s @ d)
        return np.concatenate([there.tip, there.trocar, [there.axial]])

    numeric = differences(with_trocar_at, 3)
    np.testing.assert_allclose(pivot_jacobian(found), numeric, rtol=1e-6, atol=1e-3)


def differences(function: Callable[[Array], Array], n: int, h: float = 1e-6) -> Array:
    """Central differences, one column for each of n arguments about zero."""
    return np.array([(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(n)]).T


def test_a_depth_that_is_not_positive_is_refused() -> None:
    for depth in (0.0, -0.01, float("nan")):
        with pytest.raises(ValueError, match="depth"):
            split(np.zeros(6), np.array([0.0, 0.0, 1.0]), depth)
