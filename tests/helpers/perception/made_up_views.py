"""Folders of views without pictures: corners with noise where a board detector would find them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from helpers.sim.board_bench import BenchView, BoardBench
from helpers.sim.board_views import BOARD
from surg_perception.calibration import base_steps, steps
from surg_perception.calibration.board import Corners
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.views import View, Views

NOISE = 0.05
"""[px] Of a corner, as rendered boards have."""


def made_up(bench: BoardBench, shown: Iterable[BenchView], rng: np.random.Generator) -> list[View]:
    """What a folder with these views would be read as."""
    views = []
    for number, view in enumerate(shown):
        joints = {
            f"{arm}/{name}": float(q)
            for arm, positions in view.joints.items()
            for name, q in zip(bench.cell.arms[arm].robot.joint_names, positions, strict=True)
        }
        eyes = []
        for true in bench.pixels(view, BOARD.corners):
            pixels = true + rng.normal(scale=NOISE, size=true.shape)
            inside = ((pixels > 3) & (pixels < np.array(bench.size) - 4)).all(axis=1)
            eyes.append(Corners(np.flatnonzero(inside), pixels[inside]))
        views.append(View(f"{number:03d}", number, joints, view.touch, (eyes[0], eyes[1])))
    return views


def folders(
    monkeypatch: pytest.MonkeyPatch, root: Path, of: dict[str, tuple[BoardBench, list[View]]]
) -> dict[str, Path]:
    """Folders that the steps read as these views; each has a table, a picture and a board."""
    known = {}
    for name, (bench, views) in of.items():
        folder = root / name
        folder.mkdir()
        write_board(folder / "board.yaml", BOARD)
        (folder / "views.csv").write_text(f"view,stamp\n{name},0\n")
        (folder / "000_left.png").write_bytes(b"a picture")
        known[folder] = Views(folder, BOARD, bench.size, views, [])
    for module in (steps, base_steps):
        monkeypatch.setattr(module, "read_views", lambda folder, board, look=True: known[folder])
    return {name: root / name for name in of}
