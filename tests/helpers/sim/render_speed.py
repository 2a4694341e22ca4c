"""Measures how fast this machine renders stereo pairs; the simulator's benchmark reports it.

Wall-clock figures are valid on an idle machine only. Processor time per pair is also valid on a
busy one.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer

if TYPE_CHECKING:
    from surg_sim.physics.world import World


@dataclass(frozen=True)
class RenderSpeed:
    """What rendering stereo pairs took."""

    pairs_per_s: float  # pairs in a second of wall-clock time
    cpu_s_per_pair: float  # processor time of a pair, over all threads [s]
    backend: str  # the OpenGL platform


def stereo_speed(
    world: World, width: int = 640, height: int = 480, pairs: int = 60, seed: int = 0
) -> RenderSpeed:
    """Render pairs of a world in which everything moves a little from pair to pair.

    The world is built with ``visuals=True`` from a cell with a stereo endoscope; the skins of its
    task, if it has one, are drawn. Width and height in px.
    """
    renderer = EndoscopeRenderer(world, ("left", "right"), width, height)
    rng = np.random.default_rng(seed)
    home = np.array(world.data.qpos)
    try:
        for _ in range(3):
            renderer.render(home)
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(pairs):
            renderer.render(home + rng.normal(scale=1e-3, size=len(home)))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    finally:
        renderer.close()
    return RenderSpeed(pairs / wall, cpu / pairs, renderer.backend)
