"""The capsules of the bundled robots and instruments hold everything that is drawn of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths
from surg_core import load_instrument, load_robot

DESCRIPTION = paths.ROOT / "src" / "surg_description"
SLACK = 1e-4  # [m]
Array = NDArray[np.float64]


def surface(model: mujoco.MjModel, geom: int) -> Array:
    """Points on a geom's surface in its body's frame, (n, 3) [m]."""
    size, kind = model.geom_size[geom], model.geom_type[geom]
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        rows = [(r * circle, z) for r in (size[0], size[0] / 2) for z in (-size[1], 0.0, size[1])]
        points = np.vstack([np.column_stack([xy, np.full(len(xy), z)]) for xy, z in rows])
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        rows = [
            (np.cos(p) * size[0] * circle, np.sin(p) * size[0]) for p in np.linspace(-1.5, 1.5, 9)
        ]
        points = np.vstack([np.column_stack([xy, np.full(len(xy), z)]) for xy, z in rows])
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        grid = np.array(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3)).reshape(3, -1).T
        points = grid[np.abs(grid).max(axis=1) == 1.0] * size
    else:
        raise AssertionError(f"no points for geom type {kind}")
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return np.asarray(points @ R.reshape(3, 3).T + model.geom_pos[geom])


def outside(points: Array, capsules: list[surg_core.LinkCapsule]) -> float:
    """How far the worst point lies outside all capsules [m]."""
    least = np.full(len(points), np.inf)
    for c in capsules:
        a, along = np.asarray(c.a), np.asarray(c.b) - np.asarray(c.a)
        t = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        least = np.minimum(
            least, np.linalg.norm(points - a - t[:, None] * along, axis=1) - c.radius
        )
    return float(least.max())


def geoms_in(model: mujoco.MjModel, frames: list[str]) -> Iterator[tuple[int, str, Array]]:
    """Every geom with the frame it is fixed to and its surface in that frame, at zero joints."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        points = surface(model, geom) @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        root = body
        while model.body(root).name not in frames:
            root = int(model.body_parentid[root])
        frame = model.body(root)
        R, p = data.xmat[root].reshape(3, 3), data.xpos[root]
        yield geom, frame.name, (points - p) @ R


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_each_link_lies_inside_its_capsules(name: str) -> None:
    robot = load_robot(DESCRIPTION / "robots" / f"{name}.yaml")
    spec = mujoco.MjSpec.from_string((DESCRIPTION / "urdf" / f"{name}.urdf").read_text())
    links = [spec.joint(joint).parent.name for joint in robot.joint_names]
    model, seen, worst = spec.compile(), 0, -np.inf
    for _, frame, points in geoms_in(model, [robot.base_link, "world", *links]):
        joint = links.index(frame) if frame in links else -1
        worst = max(worst, outside(points, [c for c in robot.capsules if c.joint == joint]))
        seen += 1
    print(f"{name}: {seen} geoms; the worst point is {1e3 * worst:.2f} mm outside")
    assert seen > 15
    assert worst < SLACK


@pytest.mark.parametrize("name", ["grasper", "endoscope"])
def test_each_instrument_lies_inside_its_capsules(name: str) -> None:
    instrument = load_instrument(DESCRIPTION / "instruments" / f"{name}.yaml")
    spec = mujoco.MjSpec.from_string((DESCRIPTION / "urdf" / f"{name}.urdf").read_text())
    model, seen = spec.compile(), 0
    for _, _, points in geoms_in(model, [instrument.mount_link, "world"]):
        assert outside(points, list(instrument.capsules)) < SLACK
        seen += 1
    assert seen > 5
    assert [c.name for c in instrument.capsules if c.shaft] == ["shaft"]


def test_a_capsule_that_is_too_thin_is_noticed() -> None:
    robot = load_robot(Path(DESCRIPTION / "robots" / "ur5e.yaml"))
    rim = np.array([[0.0, 0.06, 0.2]])  # of the shoulder
    mine = [c for c in robot.capsules if c.joint == 0]
    assert outside(rim, mine) < 0.0 < outside(1.1 * rim, mine)
