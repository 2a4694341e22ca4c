"""Four ways to the same flange: MuJoCo, KDL, the core's chain, the DH formula."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.control import dh
from surg_cli.host import paths
from surg_core.urdf import chain_from_urdf, fixed_transform, read_joints

Matrix = NDArray[np.float64]
Forward = Callable[[Matrix], Matrix]
POSTURES = 20_000 if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 500
URDF = paths.ROOT / "src/surg_description/urdf"
ORACLES: dict[str, tuple[int, Callable[[Matrix], Matrix]]] = {
    "ur3e": (6, lambda q: dh.ur(q, dh.UR3E)),
    "ur5e": (6, dh.ur5e),
    "ur10e": (6, lambda q: dh.ur(q, dh.UR10E)),
    "panda": (7, dh.panda),
    "fr3": (7, dh.panda),
    "xarm7": (7, lambda q: dh.modified(q, dh.XARM7)),
}


def by_mujoco(urdf: Path) -> Forward:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(urdf))
    data = mujoco.MjData(model)

    def forward(q: Matrix) -> Matrix:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        pose = np.eye(4)
        pose[:3, :3] = data.body("flange").xmat.reshape(3, 3)
        pose[:3, 3] = data.body("flange").xpos
        return pose

    return forward


def by_kdl(urdf: Path) -> Forward:
    kdl = pytest.importorskip("PyKDL")
    chain = kdl.Chain()
    for joint in read_joints(urdf, "base_link", "flange"):
        # A KDL segment is a joint at its start and a fixed frame behind it.
        rotation = kdl.Rotation(*joint.X_PJ[:3, :3].ravel().tolist())
        frame = kdl.Frame(rotation, kdl.Vector(*joint.X_PJ[:3, 3].tolist()))
        chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.Fixed), frame))
        if joint.turning:
            axis = kdl.Vector(*joint.axis.tolist())
            turning = kdl.Joint(kdl.Vector(0, 0, 0), axis, kdl.Joint.RotAxis)
            chain.addSegment(kdl.Segment(turning, kdl.Frame()))
    solver = kdl.ChainFkSolverPos_recursive(chain)

    def forward(q: Matrix) -> Matrix:
        joints, frame = kdl.JntArray(len(q)), kdl.Frame()
        for i, value in enumerate(q):
            joints[i] = float(value)
        # The solver holds a bare reference to the chain: naming it here keeps it alive.
        assert chain.getNrOfJoints() == len(q)
        assert solver.JntToCart(joints, frame) == 0
        return np.array([[frame[i, j] for j in range(4)] for i in range(3)] + [[0, 0, 0, 1.0]])

    return forward


def by_core(urdf: Path) -> Forward:
    joints = read_joints(urdf, "base_link", "flange")
    names = [joint.name for joint in joints if joint.turning]
    chain = chain_from_urdf(urdf, "base_link", "flange", names)
    return lambda q: np.asarray(chain.forward(q))


def angle(A: Matrix, B: Matrix) -> float:
    """Angle [rad] between two poses' orientations, exact for small angles."""
    return float(2.0 * np.arcsin(min(1.0, np.linalg.norm(A[:3, :3] - B[:3, :3]) / np.sqrt(8.0))))


@pytest.mark.parametrize("name", ORACLES)
@pytest.mark.parametrize("way", [by_mujoco, by_kdl, by_core])
def test_forward_kinematics_agree(name: str, way: Callable[[Path], Forward]) -> None:
    rng = np.random.default_rng(20261121)
    forward = way(URDF / f"{name}.urdf")
    worst_m = worst_rad = 0.0
    joints, oracle = ORACLES[name]
    for q in rng.uniform(-np.pi, np.pi, (POSTURES, joints)):
        expected, got = oracle(q), forward(q)
        worst_m = max(worst_m, float(np.linalg.norm(got[:3, 3] - expected[:3, 3])))
        worst_rad = max(worst_rad, angle(got, expected))
    print(f"{name} {way.__name__}: {POSTURES} postures, {worst_m:.1e} m, {worst_rad:.1e} rad")
    assert worst_m < 1e-6
    assert worst_rad < 1e-6


def test_a_wrong_parameter_is_noticed() -> None:
    """The oracle must be able to fail: half a millimetre in one link."""
    forward = by_core(URDF / "ur5e.urdf")
    wrong = [row if i else (row[0] + 5e-4, *row[1:]) for i, row in enumerate(dh.UR5E)]
    q = np.full(6, 0.3)
    original = dh.UR5E
    try:
        dh.UR5E = tuple(wrong)  # type: ignore[assignment]
        assert np.linalg.norm(dh.ur5e(q)[:3, 3] - forward(q)[:3, 3]) > 1e-4
    finally:
        dh.UR5E = original


def test_urs_own_base_is_turned_by_half_a_turn() -> None:
    X = fixed_transform(URDF / "ur5e.urdf", "base_link", "base")
    assert np.allclose(X, np.diag([-1.0, -1.0, 1.0, 1.0]), atol=1e-15)


def test_instrument_is_sixty_millimetres_beside_the_flange() -> None:
    X = fixed_transform(URDF / "grasper.urdf", "mount", "tip")
    assert np.allclose(X[:3, 3], [0.06, 0.0, 0.3])
    assert np.allclose(X[:3, :3], np.eye(3))


@pytest.mark.parametrize("name", [*ORACLES, "grasper"])
def test_urdf_is_ready_for_mujoco(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(URDF / f"{name}.urdf"))
    moving = [i for i in range(1, model.nbody) if model.body_dofnum[i] > 0]
    assert all(model.body_mass[i] > 0 and (model.body_inertia[i] > 0).all() for i in moving)
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
