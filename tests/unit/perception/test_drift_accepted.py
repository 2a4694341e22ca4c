"""Whether an accepted correction is as good as a fresh calibration, and touches nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.perception.drift_bench import (
    SCOPE,
    TOOL,
    DriftBench,
    Motion,
    Moved,
    look_without_pictures,
)
from helpers.results.perception_results import PAGE
from surg_core.base_file import load_base
from surg_core.camera_file import load_camera
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import LEFT, RIGHT, Origin
from surg_perception.drift.accepted_drift import accept
from surg_perception.drift.drift_state import MOVED, DriftState
from surg_perception.drift.drift_watch import DriftWatch

ORIGIN = Origin("seen in a recording", "2026-11-30", "simulated")
SECONDS = 60.0
LOOKED_AT = np.array([[x, y, 0.08, 1.0] for x in (-0.015, 0, 0.015) for y in (-0.015, 0, 0.015)]).T
"""Points 80 mm before the eye [m]."""


def drawn(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """A vector of any direction, small and large as often."""
    way, size = rng.normal(size=3), np.exp(rng.uniform(np.log(low), np.log(high)))
    return np.asarray(size * way / np.linalg.norm(way))


@dataclass
class Recovery:
    """A cell whose part moves, and a recording of it without pictures."""

    folder: Path
    seed: int
    moved: Moved
    cause: str = "camera"
    seconds: float = SECONDS
    outliers: float = 0.0

    def __post_init__(self) -> None:
        """Calibrate the cell."""
        self.folder.mkdir()
        self.bench = DriftBench(self.folder, 60 + self.seed)

    @cached_property
    def motion(self) -> Motion:
        return Motion(self.bench.chain, self.seed, self.seconds, True)

    def accept(self) -> list[Path]:
        calibration = self.bench.folder / "calibration"
        lenses = [load_lens(calibration / eye) for eye in (LEFT, RIGHT)]
        state = DriftState(MOVED, cause=self.cause)
        return accept(self.bench.cell, state, lenses, self._look, ORIGIN)

    def _look(self, watch: DriftWatch) -> None:
        rng = np.random.default_rng(self.seed)
        elsewhere = Moved(lens={0: np.array([40.0, -30.0]), 1: np.array([-30.0, 50.0])})
        for at in self.motion.t:
            now = elsewhere if rng.uniform() < self.outliers else self.moved
            look_without_pictures(watch, self.bench, self.motion, float(at), now, rng)

    def off(self, moved: Moved) -> tuple[float, float]:
        """How far a tip 80 mm before the eye, and a command in its axes, go wrong [mm], [deg]."""
        chain, cell = self.bench.chain, surg_core.load_cell(self.bench.folder)
        q = np.array(cell.arms[SCOPE].robot.home)
        X_BF = np.asarray(chain.cell.arms[SCOPE].chain.forward(q))
        X_WB = chain.X_W_ECM.copy()
        x = moved.base.get(SCOPE, np.zeros(6))
        X_WB[:3, :3] = Rotation.from_rotvec(x[:3]).as_matrix() @ X_WB[:3, :3]
        X_WB[:3, 3] += x[3:]
        X_VV = surg_core.make_pose(moved.camera[3:])
        X_VV[:3, :3] = Rotation.from_rotvec(moved.camera[:3]).as_matrix()
        true = X_WB @ X_BF @ chain.bench.X_FV @ X_VV
        file = self.bench.folder / "calibration" / "camera_ECM.yaml"
        believed = cell.arms[SCOPE].X_WB @ X_BF @ load_camera(file).X_FV
        E = np.linalg.inv(believed) @ true
        shift = np.linalg.norm((E @ LOOKED_AT - LOOKED_AT)[:3], axis=0)
        turn = Rotation.from_matrix(E[:3, :3]).magnitude()
        return 1e3 * float(np.sqrt(np.mean(shift**2))), float(np.degrees(turn))


def bump(seed: int, part: str = "camera") -> Moved:
    rng = np.random.default_rng(9000 + seed)
    step = np.r_[drawn(rng, np.radians(1.0), np.radians(10.0)), drawn(rng, 0.0015, 0.02)]
    if part == "camera":
        return Moved(camera=step)
    return Moved(base={SCOPE: np.r_[step[:3] / 5.0, step[3:]]})


@pytest.mark.parametrize("part", ["camera", f"base of {SCOPE}"])
def test_an_accepted_bump_leaves_what_a_fresh_calibration_leaves(
    part: str, tmp_path: Path, full: bool
) -> None:
    count, rows, refused = (24 if part == "camera" else 8) if full else 1, [], 0
    for seed in range(count):
        made = Recovery(tmp_path / str(seed), seed, bump(seed, part), part)
        fresh, bumped = made.off(Moved()), made.off(made.moved)
        try:
            made.accept()
        except surg_core.ConfigError as why:
            print(seed, why)
            refused += 1
            continue
        rows.append([fresh, bumped, made.off(made.moved)])
        print(seed, np.round(rows[-1], 3).tolist())
    fresh, bumped, after = np.array(rows).transpose(1, 0, 2)
    said = "; ".join(
        f"{name} {np.median(x, axis=0)[0]:.3f} mm, {np.median(x, axis=0)[1]:.3f}° (95 %: "
        f"{np.percentile(x, 95, axis=0)[0]:.3f} mm, {np.percentile(x, 95, axis=0)[1]:.3f}°)"
        for name, x in (("fresh", fresh), ("bumped", bumped), ("after", after))
    )
    print(f"{part}: {said}; {refused} of {count} refused")
