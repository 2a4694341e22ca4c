"""Views of a calibration board on the simulated bench, and what is true about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.sim.board_bench import BenchView, BoardBench, Pattern
from surg_cli.host import paths
from surg_core.transforms import rotation_of
from surg_perception.calibration.board import Board
from surg_perception.calibration.intrinsics import SeenCorners
from surg_sim.appearance.lens import EndoscopeLens
from surg_sim.physics.endoscope_rig import camera_poses

Array = NDArray[np.float64]

BOARD = Board()
BARREL = EndoscopeLens((-0.30, 0.08, 0.0005, -0.0005, 0.0), 1.01, (0.01, -0.008), 0.4)
"""A wide, dark-edged lens, off its centre."""
PINHOLE = EndoscopeLens()


def scope_cell() -> surg_core.Cell:
    """The bundled cell whose arm ECM holds an endoscope."""
    return surg_core.load_cell(paths.ROOT / "cells" / "sim_two_arms")


def bench(
    seed: int,
    lens: EndoscopeLens = PINHOLE,
    size: tuple[int, int] = (640, 480),
    *,
    cell: surg_core.Cell | None = None,
    pixels: int = 60,
    X_FV: Array | None = None,
    X_WB: dict[str, Array] | None = None,
) -> BoardBench:
    """The bench with the board; ``pixels`` of a square in the pattern's picture."""
    pattern = Pattern(BOARD.picture(pixels), BOARD.size)
    return BoardBench(
        cell or scope_cell(), pattern, size, seed, (lens, lens), X_FV=X_FV, X_WB=X_WB or {}
    )


def corners(
    of: BoardBench, view: BenchView, noise: float, rng: np.random.Generator
) -> tuple[SeenCorners, SeenCorners]:
    """What both eyes see, with noise [px] and without pictures."""
    found = []
    for true in of.pixels(view, BOARD.corners):
        pixels = true + rng.normal(scale=noise, size=true.shape)
        inside = ((pixels > 3) & (pixels < np.array(of.size) - 4)).all(axis=1)
        found.append(SeenCorners(BOARD.corners[inside], pixels[inside]))
    return found[0], found[1]


def moved_camera(rng: np.random.Generator, shift: float = 0.01, tilt_deg: float = 5.0) -> Array:
    """A camera pose (4, 4) in the flange that nobody knows: up to this far from the drawing's."""
    X = np.array(camera_poses(scope_cell().arms["ECM"])[0])
    w, d = rng.normal(size=3), rng.normal(size=3)
    angle = np.radians(tilt_deg) * rng.uniform()
    X[:3, :3] = rotation_of(angle * w / np.linalg.norm(w)) @ X[:3, :3]
    X[:3, 3] += shift * rng.uniform() * d / np.linalg.norm(d)
    return X
