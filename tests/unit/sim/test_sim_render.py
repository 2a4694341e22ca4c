"""The endoscope's picture: geometry, intrinsics, and what happens without OpenGL."""

from __future__ import annotations

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_sim.appearance import anatomy, opengl
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.render import Intrinsics, Renderer
from surg_sim.physics import scene
from surg_sim.physics.world import World

CELLS = ("sim_ur5e", "sim_panda")


@pytest.fixture(scope="module", params=CELLS)
def world(request: pytest.FixtureRequest) -> World:
    return World(surg_core.load_cell(paths.ROOT / "cells" / request.param), visuals=True)


def renderer_of(world: World, **keys: object) -> Renderer:
    try:
        hidden = [OUTSIDE]
        return Renderer(world.model, [scene.ENDOSCOPE], 640, 480, hidden=hidden, **keys)
    except NoOpenGL as error:
        pytest.skip(str(error))


def in_camera(renderer: Renderer, world: World, point_B: np.ndarray) -> np.ndarray:
    """A point of the (world-aligned) base frame in the optical frame."""
    X_WC = renderer.camera_pose()
    return X_WC[:3, :3].T @ (point_B - X_WC[:3, 3])


def test_the_camera_looks_at_the_work_point(world: World) -> None:
    renderer = renderer_of(world)
    truth = world.truth("PSM1")
    tip = in_camera(renderer, world, truth.tip)
    assert 0.09 <= np.linalg.norm(tip) <= 0.11
    pixel = renderer.intrinsics.project(tip)
    assert np.abs(pixel - [319.5, 239.5]).max() < 40, "home tip is near the middle"
    trocar = in_camera(renderer, world, truth.trocar)
    seen = renderer.intrinsics.project(0.6 * tip + 0.4 * trocar)
    assert np.linalg.norm(seen - pixel) > 60, "the shaft is seen from the side"
    renderer.close()


def test_the_picture_is_worth_looking_at(world: World) -> None:
    renderer = renderer_of(world, vignette=True)
    first = renderer.render(world.data.qpos)[0]
    assert first.shape == (480, 640, 3) and first.dtype == np.uint8
    assert np.array_equal(first, renderer.render(world.data.qpos)[0]), "same state, other picture"
    middle = first[120:360, 160:480].astype(float)
    assert 50 < middle.mean() < 200 and middle.std() > 20
    assert first[0, 0].max() == 0, "the vignette is round"
    moved = world.data.qpos.copy()
    moved[0] += 0.05
    assert not np.array_equal(first, renderer.render(moved)[0])
    with pytest.raises(ValueError, match="this scene has"):
        renderer.render(moved[:-1])
    renderer.close()


def test_without_opengl_one_message_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(opengl, "probe", lambda backend: f"no lib{backend}")
    with pytest.raises(NoOpenGL) as error:
        opengl.choose_backend.__wrapped__()
    text = str(error.value)
    assert "no libegl" in text and "no libosmesa" in text and opengl.APT_LINE in text


def test_osmesa_steps_in_for_egl(monkeypatch: pytest.MonkeyPatch) -> None:
    """EGL is broken for real: a device that does not exist."""
    if opengl.probe("osmesa"):
        pytest.skip("no OSMesa on this machine")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "99")
    assert "99" in opengl.probe("egl")
    assert opengl.choose_backend.__wrapped__() == "osmesa"


def test_intrinsics_formula() -> None:
    intrinsics = Intrinsics.from_fovy(640, 480, 90.0)
    assert intrinsics.f == pytest.approx(240)
    assert intrinsics.project(np.array([0, 0.1, 0.1])) == pytest.approx([319.5, 239.5 + 240])


def outward(mesh: anatomy.Mesh, middle: np.ndarray) -> float:
    """Share of the triangles that face away from a point."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = np.einsum("ij,ij->i", normals, corners.mean(axis=1) - middle)
    return float((away > -1e-15).mean())


def test_surfaces_face_the_right_way() -> None:
    angle = np.linspace(0, 1, 30)
    straight = anatomy.tube(np.outer(angle, [0, 0, 1.0]), np.full(30, 0.1))
    corners = straight.vertices[straight.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(np.einsum("ij,ij->i", normals[:, :2], corners.mean(axis=1)[:, :2]) > 0)
    dome = anatomy.Dome(0.2, 0.25, 0.15, window=0.8, window_top=0.9)
    assert outward(dome.wall(), np.array([0, 0, 0.05])) == 1.0
    assert outward(dome.wall().flipped(), np.array([0, 0, 0.05])) < 0.1
    lines = np.linspace(-1, 1, 9)
    flat = anatomy.surface(lambda x, y: 0 * x, lines, lines, 1.0)
    assert outward(flat, np.array([0, 0, -1.0])) == 1.0
    disc = anatomy.disc(lambda x, y: 0 * x, 1.0, 2.0, 1.0)
    assert outward(disc, np.array([0, 0, -1.0])) == 1.0
