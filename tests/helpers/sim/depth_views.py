"""Pairs of the simulated endoscope over the bowel, with the renderer's own depth buffer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths
from surg_core.lens_file import Lens
from surg_sim import tasks
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.render import Renderer
from surg_sim.physics.world import World

Picture = NDArray[np.uint8]

NOISE = 2.0
"""[grey levels] Of the sensor, one sigma."""
RANGE = (0.050, 0.120)
"""[m] Distances that count."""
LIT = 12
"""[grey levels] Darker pixels lie outside the round picture."""
PLACES = (
    (0.010, 0.0),
    (0.020, 0.005),
    (0.030, -0.005),
    (0.040, 0.0),
    (0.050, 0.010),
    (0.055, -0.010),
)
"""[m] Of each view: how far the eyes are moved into the scene, and to the right."""


@dataclass(frozen=True)
class DepthView:
    """One pair with noise, and the true depth of the left eye's pixels (h, w) [m]."""

    left: Picture
    right: Picture
    depth: NDArray[np.float32]

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Which pixels count."""
        lit = self.left.mean(axis=2) > LIT
        return np.asarray((self.depth > RANGE[0]) & (self.depth < RANGE[1]) & lit)


class DepthScene:
    """The phantom with the bowel; the eyes are moved towards it."""

    def __init__(self, size: tuple[int, int] = (640, 480), seed: int = 0) -> None:
        cell = surg_core.load_cell(paths.CELLS / "sim_two_arms")
        self.world = World(cell, seed, visuals=True, task=tasks.load("bgr"))
        try:
            self.eyes = EndoscopeRenderer(self.world, ("left", "right"), *size)
        except NoOpenGL as error:
            pytest.skip(str(error))
        self.size, self.rng = size, np.random.default_rng(seed)
        self._qpos = np.array(self.world.data.qpos)
        model = self.world.model
        self._ids = [model.camera(f"endoscope_{eye}").id for eye in ("left", "right")]
        self._home = model.cam_pos[self._ids].copy()

    def lenses(self) -> tuple[Lens, Lens]:
        """The pinholes that are rendered."""
        return self.eyes.lens("left"), self.eyes.lens("right")

    def views(self) -> Iterator[DepthView]:
        """One for each of `PLACES`."""
        for inwards, aside in PLACES:
            yield self.view(inwards, aside)

    def way(self, count: int) -> Iterator[DepthView]:
        """Views on the way through `PLACES`, as a moving endoscope records them."""
        steps = np.linspace(0.0, len(PLACES) - 1, count)
        inwards, aside = np.array(PLACES).T
        for step in steps:
            places = (np.interp(step, np.arange(len(PLACES)), way) for way in (inwards, aside))
            yield self.view(*map(float, places))

    def view(self, inwards: float, aside: float) -> DepthView:
        """With the eyes moved from their place at home [m]."""
        self.move(inwards, aside)
        depth = self._depth()
        seen = self.eyes.render(self._qpos)
        left, right = (self._noisy(seen[eye]) for eye in ("left", "right"))
        return DepthView(left, right, depth)

    def move(self, inwards: float, aside: float) -> None:
        """Move both eyes from their place at home [m]."""
        model = self.world.model
        for n, camera in enumerate(self._ids):
            R = np.zeros(9)
            mujoco.mju_quat2Mat(R, model.cam_quat[camera])
            # A MuJoCo camera looks along -z with y up.
            way = R.reshape(3, 3) @ np.array([aside, 0.0, -inwards])
            model.cam_pos[camera] = self._home[n] + way

    def _depth(self) -> NDArray[np.float32]:
        """The depth buffer of the left eye [m]; NaN where nothing is drawn."""
        renderer: Renderer = self.eyes._renderer
        rect, model = renderer._rect, self.world.model
        renderer._arrange(self._qpos)
        mujoco.mjr_render(rect, renderer._scene, renderer._mjr)
        buffer = np.empty((rect.height, rect.width), np.float32)
        mujoco.mjr_readPixels(None, buffer, rect, renderer._mjr)
        # mjr_readPixels states OpenGL's window depth d of near and far planes:
        # z = near / (1 - d (1 - near / far)).
        near = model.vis.map.znear * model.stat.extent
        far = model.vis.map.zfar * model.stat.extent
        depth = near / (1.0 - buffer[::-1] * (1.0 - near / far))
        whole = np.full(self.size[::-1], np.nan, np.float32)
        whole[:, renderer._left : self.size[0] - renderer._left] = depth
        return whole

    def _noisy(self, picture: Picture) -> Picture:
        noisy = picture + self.rng.normal(scale=NOISE, size=picture.shape)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)
