"""A person who calibrates moves arms and a board before the eyes: that is no alarm."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from helpers.perception.drift_bench import SCALE, DriftBench, Moved
from helpers.perception.walk_recording import Rest, record_walk
from helpers.sim.board_bench import BenchView
from helpers.sim.board_views import BOARD
from helpers.sim.calibrated_chain import TOUCHED
from surg_perception.calibration.result_files import Origin
from surg_perception.drift.drift_step import drift


def drawn(bench: DriftBench, view: BenchView) -> Rest:
    """The board as both eyes see it, and before it the shaft where it truly is."""
    homes = {name: np.array(arm.robot.home) for name, arm in bench.cell.arms.items()}
    joints = homes | dict(view.joints)
    motion = SimpleNamespace(joints=lambda arm, at: joints[arm])
    p_V = bench.shaft(motion, 0.0, Moved(), np.linspace(0.012, 0.16, 60))  # type: ignore[arg-type]
    pictures = []
    for eye, grey in enumerate(bench.chain.bench.pictures(view)):
        wall = cv2.resize(grey, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
        bench.__dict__["_wall"] = np.repeat(wall[..., None], 3, axis=2)
        pictures.append(bench._draw(p_V, eye, Moved()))
    return joints, tuple(pictures)


def test_the_recorded_walk_of_the_guide_is_no_alarm(tmp_path: Path, full: bool) -> None:
    for seed in range(4 if full else 1):
        (tmp_path / f"cell{seed}").mkdir()
        bench = DriftBench(tmp_path / f"cell{seed}", 33 + seed)
        of = bench.chain.bench
        views = [*of.moved_scope(15), *of.touches(BOARD.corners, TOUCHED)]
        rests = (drawn(bench, view) for view in views)
        episode = record_walk(tmp_path / f"walk{seed}", bench.cell, rests)
        lines = drift(bench.cell, episode, Origin("walk", "2026-11-30", "simulated"), False)
        print(*lines, sep="\n")
        assert not any(": moved: " in line for line in lines)
