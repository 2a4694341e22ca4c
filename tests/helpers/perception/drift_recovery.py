"""A calibrated cell whose part moves, a recording of it, and what its frames are worth.

The truth is the bench's: which pose a camera and a base really have.
"""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import surg_core
from helpers.perception.drift_bench import (
    SCOPE,
    TOOL,
    Array,
    DriftBench,
    Motion,
    Moved,
    look_without_pictures,
)
from helpers.sim.calibrated_chain import Chain
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


def drawn(rng: np.random.Generator, low: float, high: float) -> Array:
    """A vector of any direction, small and large as often."""
    way, size = rng.normal(size=3), np.exp(rng.uniform(np.log(low), np.log(high)))
    return np.asarray(size * way / np.linalg.norm(way))


@dataclass
class Recovery:
    """A cell whose part moves, and a recording of it without pictures.

    Attributes:
        folder: A new folder for the cell.
        seed: Of calibration and motion.
        moved: By how much.
        cause: What the watch has named.
        seconds: Length of the recording [s].
        outliers: Share of pictures in which another shaft is taken for the instrument's.
    """

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

    @property
    def camera(self) -> Path:
        """The camera's file."""
        return self.bench.folder / "calibration" / "camera_ECM.yaml"

    @property
    def base(self) -> Path:
        """The file of the second arm's base."""
        return self.bench.folder / "calibration" / "base_ECM.yaml"

    @cached_property
    def motion(self) -> Motion:
        """Of both arms."""
        return Motion(self.bench.chain, self.seed, self.seconds, True)

    def accept(self) -> list[Path]:
        """As `./surg calibrate CELL drift --accept` does it."""
        calibration = self.bench.folder / "calibration"
        lenses = [load_lens(calibration / eye) for eye in (LEFT, RIGHT)]
        state = DriftState(MOVED, cause=self.cause)
        return accept(self.bench.cell, state, lenses, self._look, ORIGIN)

    def accept_at_last(self) -> None:
        """As a person who records for longer when that is asked for."""
        for seconds in (60.0, 120.0, 240.0):
            self.seconds = seconds
            self.__dict__.pop("motion", None)
            with suppress(surg_core.ConfigError):
                self.accept()
                return
        raise AssertionError(f"seed {self.seed}: nothing is accepted")

    def _look(self, watch: DriftWatch) -> None:
        rng = np.random.default_rng(self.seed)
        elsewhere = Moved(lens={0: np.array([40.0, -30.0]), 1: np.array([-30.0, 50.0])})
        for at in self.motion.t:
            now = elsewhere if rng.uniform() < self.outliers else self.moved
            look_without_pictures(watch, self.bench, self.motion, float(at), now, rng)

    def _true(self, moved: Moved) -> Chain:
        chain = copy(self.bench.chain)
        chain.bench, chain.rng = copy(chain.bench), np.random.default_rng(7)
        X_VV = surg_core.make_pose(moved.camera[3:])
        X_VV[:3, :3] = Rotation.from_rotvec(moved.camera[:3]).as_matrix()
        chain.bench.X_FV = chain.bench.X_FV @ X_VV
        X_WT = np.array(chain.cell.arms[TOOL].X_WB_stated)
        X_W_ECM = stepped(chain.X_W_ECM, moved.base.get(SCOPE))
        # How the one base stands to the other is all that counts: a moved tool moves the scope.
        chain.X_W_ECM = X_WT @ np.linalg.inv(stepped(X_WT, moved.base.get(TOOL))) @ X_W_ECM
        return chain

    def frame(self, moved: Moved) -> Array:
        """(4, 4) from the true left eye's axes to those that the cell states, scope at home."""
        chain, cell, X_FV = self._true(moved), surg_core.load_cell(self.bench.folder), self.X_FV
        q = np.array(cell.arms[SCOPE].robot.home)
        X_BF = np.asarray(chain.cell.arms[SCOPE].chain.forward(q))
        believed = cell.arms[SCOPE].X_WB @ X_BF @ X_FV
        return np.asarray(np.linalg.inv(believed) @ chain.X_W_ECM @ X_BF @ chain.bench.X_FV)

    @property
    def X_FV(self) -> Array:
        """(4, 4) the camera in its flange, as the cell states it."""
        X_FV = load_camera(self.camera).X_FV
        assert X_FV is not None
        return X_FV

    def off(self, moved: Moved) -> tuple[float, float, float]:
        """How far a tip 80 mm before the eye goes wrong [mm], and a command in its axes [deg].

        The third is how far joints and picture then disagree, seen through the lenses [mm].
        """
        E, cell, chain = (
            self.frame(moved),
            surg_core.load_cell(self.bench.folder),
            self._true(moved),
        )
        shift = np.linalg.norm((E @ LOOKED_AT - LOOKED_AT)[:3], axis=0)
        turn = Rotation.from_matrix(E[:3, :3]).magnitude()
        seen = np.median([chain.disagreement(cell, self.X_FV) for _ in range(25)])
        return 1e3 * float(np.sqrt(np.mean(shift**2))), float(np.degrees(turn)), 1e3 * float(seen)


def stepped(X: Array, step: Array | None) -> Array:
    """A base (4, 4) after a step (6,) in the world's axes."""
    moved = X.copy()
    if step is not None:
        moved[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ X[:3, :3]
        moved[:3, 3] += step[3:]
    return moved


def bump(seed: int, part: str = "camera") -> Moved:
    """A part moved by 1 to 10 degrees and 1.5 to 20 mm, a base turned by a fifth of it."""
    rng = np.random.default_rng(9000 + seed)
    step = np.r_[drawn(rng, np.radians(1.0), np.radians(10.0)), drawn(rng, 0.0015, 0.02)]
    if part == "camera":
        return Moved(camera=step)
    return Moved(
        base={part[-len(SCOPE) :] if SCOPE in part else TOOL: step / ([5.0] * 3 + [1.0] * 3)}
    )
