"""What is drawn of the bowel: a smooth tube with outward normals, pinched where it is held."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from helpers.sim.phantom import Phantom, arm_of
from surg_sim.appearance.tissue_skin import _FINE, _ROUND, BowelSkin, _carried, add_skin
from surg_sim.physics import scene
from surg_sim.physics.assistant_scene import add_assistant
from surg_sim.physics.tissue import TissueParameters, add_bowel
from surg_sim.physics.tissue_grasp import add_grasp

P = TissueParameters()


@pytest.fixture(scope="module")
def drawn() -> mujoco.MjModel:
    """The helper's scene with the skins in it, without the rest of the room."""
    arm = arm_of("sim_ur5e")

    def add(spec: mujoco.MjSpec, site: scene.Site) -> None:
        spec.add_material(name="bowel")
        add_bowel(spec, site, P)
        add_skin(spec, site, P)
        add_assistant(spec, site, arm.instrument_urdf, visuals=True)
        add_grasp(spec, "PSM1")
        add_grasp(spec, "assistant")

    return scene.build([arm], add=add)


class Picture:
    """The vertices that a picture at these joint positions would show."""

    def __init__(self, model: mujoco.MjModel, qpos: np.ndarray) -> None:
        self._model, self._data = copy.copy(model), mujoco.MjData(model)
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        canvas = mujoco.MjvScene(model, maxgeom=1000)
        mujoco.mjv_updateScene(
            model, self._data, mujoco.MjvOption(), None, mujoco.MjvCamera(),
            mujoco.mjtCatBit.mjCAT_ALL, canvas,
        )  # fmt: skip
        self.skin = BowelSkin(model, scene.site_of([arm_of("sim_ur5e")]), P)
        self.skin.draw(canvas, self._data)
        self.centre = self.skin.centre(self._data)
        count = model.skin("bowel_tube").vertnum[0]
        shape = (len(self.centre), _ROUND, 3)
        self.tube = np.array(canvas.skinvert[: 3 * count], dtype=np.float64).reshape(shape)
        self.normal = np.array(canvas.skinnormal[: 3 * count], dtype=np.float64).reshape(shape)
        self.sheet = np.array(canvas.skinvert[3 * count :], dtype=np.float64).reshape(-1, 3)

    @property
    def girth(self) -> np.ndarray:
        """Circumference of every ring [m]."""
        return np.linalg.norm(np.diff(self.tube, axis=1), axis=2).sum(axis=1)

    @property
    def volume(self) -> float:
        """Volume inside the tube [m^3], by the divergence theorem: positive if faces point out."""
        total = 0.0
        a, b = self.tube[:-1, :-1], self.tube[:-1, 1:]
        c, d = self.tube[1:, 1:], self.tube[1:, :-1]
        for u, v, w in ((a, b, c), (a, c, d)):
            total += float(np.einsum("ijk,ijk->", u, np.cross(v, w))) / 6
        return total


def test_the_tube_is_round_closed_and_lit_from_outside(drawn: mujoco.MjModel, full: bool) -> None:
    phantom = Phantom()
    for seed in range(20 if full else 4):
        phantom.reset(seed)
        picture = Picture(drawn, phantom.data.qpos)
        inner = slice(4 * _FINE, -4 * _FINE)
        assert np.abs(picture.tube[:, 0] - picture.tube[:, -1]).max() < 1e-7
        assert np.abs(np.linalg.norm(picture.normal, axis=2)[inner] - 1).max() < 1e-5
        outward = picture.tube - picture.centre[:, None]
        outward /= np.linalg.norm(outward, axis=2, keepdims=True)
        cosine = np.einsum("ijk,ijk->ij", outward, picture.normal)[inner]
        assert cosine.min() > 0.7
        radius = picture.girth[inner] / (2 * np.pi)
        assert 0.8 * P.radius < radius.min() < radius.max() < 1.25 * P.radius
        tube = np.pi * P.radius**2 * P.spacing * (P.nodes - 1)
        assert picture.volume == pytest.approx(tube, rel=0.15)
        assert np.isfinite(picture.sheet).all()


def test_held_tissue_is_pinched_and_the_picture_knows_it_from_joints_alone(
    drawn: mujoco.MjModel,
) -> None:
    phantom = Phantom()
    before = Picture(drawn, phantom.data.qpos)
    phantom.take(18)
    held = phantom.grasp.held
    assert held is not None
    pinched = Picture(drawn, phantom.data.qpos)
    ring = held * _FINE
    frame = phantom.data.site("assistant_grip").xmat.reshape(3, 3)
    local = (pinched.tube[ring] - phantom.grasp.place) @ frame
    between = np.abs(local[local[:, 2] < 0.003, 1]).max()
    belly = np.abs(local[:, 1]).max()
    print(f"half width {between * 1e3:.1f} mm between the jaws, {belly * 1e3:.1f} mm below them")
    assert between < 0.002
    assert belly > 0.6 * P.radius
    far = np.r_[4 * _FINE : ring - 5 * _FINE, ring + 5 * _FINE : len(before.girth) - 4 * _FINE]
    others = pinched.girth[far] / before.girth[far]
    assert np.abs(others - 1).max() < 0.12
    phantom.run(80, jaw=0.6)
    again = Picture(drawn, phantom.data.qpos)
    assert np.abs(again.girth / before.girth - 1).max() < 0.1


def test_the_frame_is_carried_without_twist() -> None:
    """Along a helix, against the exact solution: it turns back by the helix' torsion."""
    t = np.linspace(0, 4 * np.pi, 4000)
    r, h = 1.0, 0.4
    c = np.hypot(r, h)
    tangent = np.column_stack([-r * np.sin(t), r * np.cos(t), np.full_like(t, h)]) / c
    normal = np.column_stack([-np.cos(t), -np.sin(t), np.zeros_like(t)])
    binormal = np.cross(tangent, normal)
    carried = _carried(tangent, normal[0])
    angle = np.unwrap(np.arctan2((carried * binormal).sum(1), (carried * normal).sum(1)))
    torsion = h / c**2
    assert np.abs(angle + torsion * c * t).max() < 0.02
    straight = _carried(np.tile([0.0, 0.0, 1.0], (3, 1)), np.array([0.0, 0.0, 1.0]))
    assert np.abs(np.linalg.norm(straight, axis=1) - 1).max() < 1e-12
