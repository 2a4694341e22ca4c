"""A calibration bench in the simulator: hands that guide the true instrument, and what is recorded.

The hands know the true tool (from the URDF) and are not steady: the tip has play in its divot, the
shaft in its guide and in the trocar. The recording sees the joint states of the simulated arm only,
with an encoder's noise and quantisation. ::

    python3 -m surg_sim.physics.calibration_bench CELL FILE.csv --motions tip roll
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.trocar import TrocarParameters, shaft_in_flange
from surg_sim.physics.world import World
from surg_sim.placement.arm_reserve import inverse

MOTIONS = ("tip", "roll", "trocar")
ENCODER_SIGMA = 2e-5
"""[rad]; assumed."""
ENCODER_STEP = 1e-5
"""[rad]; assumed."""
DIVOT_PLAY = 5e-5
"""[m] per axis, one sigma; assumed."""
GUIDE_PLAY = 1e-3
"""[rad] per axis, one sigma; assumed."""
TROCAR_PLAY = 1e-4
"""[m] per axis, one sigma; assumed."""
NO_WALL = TrocarParameters(stiffness=0.1, friction=0.0)
"""A wall that is not felt: the instrument is on a bench, not in a patient."""


def across(s: Array, rng: np.random.Generator) -> Array:
    """A random unit vector (3,) perpendicular to s (3,)."""
    v = np.cross(s, rng.normal(size=3))
    return np.asarray(v / np.linalg.norm(v))


class Bench:
    """One arm of a cell, by default the first, on the bench; hands and encoders have the seed."""

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str | None = None) -> None:
        self.cell = cell
        self.arm = cell.arms[arm or next(iter(cell.arms))]
        self.rng = np.random.default_rng(seed)
        self.p_FTip, self.s_F = shaft_in_flange(self.arm)
        self.home = np.array(self.arm.robot.home)
        self.X_home = self.arm.chain.forward(self.home)
        self.s_home = self.X_home[:3, :3] @ self.s_F
        self.tip_home = self.X_home[:3, :3] @ self.p_FTip + self.X_home[:3, 3]

    def record(self, path: Path, motions: Sequence[str], count: int = 12) -> None:
        """Perform motions of ``MOTIONS`` by hand, ``count`` poses each, and write the CSV file."""
        lines = [",".join(["motion", *self.arm.robot.joint_names])]
        for motion in motions:
            world = World(self.cell, trocar=None if motion == "trocar" else NO_WALL)
            for q in self._poses(motion, count):
                measured = self._measure(world, q)
                lines.append(",".join([motion, *(f"{value:.9f}" for value in measured)]))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _poses(self, motion: str, count: int) -> Iterator[Array]:
        """Joint positions (n,) of the hand-guided poses; what the arm cannot reach is not tried."""
        tried = (self._inverse(self._pose(motion)) for _ in range(20 * count))
        reached = 0
        for q in itertools.islice((q for q in tried if q is not None), count):
            reached += 1
            yield q
        if reached < count:
            raise RuntimeError(f"{motion}: only {reached} of {count} poses are within reach")

    def _pose(self, motion: str) -> Array:
        """A flange pose (4, 4) that puts the true instrument where the hands want it."""
        rng, R = self.rng, self.X_home[:3, :3]
        if motion == "roll":
            R = axis_angle_to_matrix(self.s_home, rng.uniform(-1.2, 1.2)) @ R
            play = rng.normal(scale=GUIDE_PLAY, size=3)
            R = axis_angle_to_matrix(play / np.linalg.norm(play), float(np.linalg.norm(play))) @ R
            tip = self.tip_home + rng.uniform(-0.02, 0.02) * self.s_home
        else:
            tilt = axis_angle_to_matrix(across(self.s_home, rng), rng.uniform(0.15, 0.5))
            R = tilt @ axis_angle_to_matrix(self.s_home, rng.uniform(-1.0, 1.0)) @ R
            if motion == "tip":
                tip = self.tip_home + rng.normal(scale=DIVOT_PLAY, size=3)
            else:
                s = R @ self.s_F
                play = rng.normal(scale=TROCAR_PLAY, size=3)
                tip = self.arm.trocar.p_BRcm + rng.uniform(0.06, 0.16) * s + play
        return surg_core.make_pose(tip - R @ self.p_FTip, R)

    def _inverse(self, X: Array) -> Array | None:
        """Joints (n,) for a flange pose (4, 4), from home; None: out of reach."""
        q = inverse(self.arm.chain, self.home, X, 100)
        low, high = self.arm.robot.position_min, self.arm.robot.position_max
        return q if q is not None and np.all((q > low) & (q < high)) else None

    def _measure(self, world: World, goal: Array) -> Array:
        """Guides the simulated arm there; what its encoders say at standstill (n,)."""
        for _ in range(3000):
            state = world.state(self.arm.name)
            if np.max(np.abs(goal - state.q)) < 2e-5 and np.max(np.abs(state.qd)) < 1e-4:
                break
            velocity = np.clip(12.0 * (goal - state.q), -0.6, 0.6)
            world.step({self.arm.name: ArmCommand(velocity=velocity)})
        q = world.state(self.arm.name).q + self.rng.normal(scale=ENCODER_SIGMA, size=len(goal))
        return np.asarray(np.round(q / ENCODER_STEP) * ENCODER_STEP)


def main(words: Sequence[str] | None = None) -> int:
    """Record motions of a cell's arm on the bench."""
    parser = argparse.ArgumentParser(
        prog="surg_sim.physics.calibration_bench", description=main.__doc__
    )
    parser.add_argument("cell", type=Path)
    parser.add_argument("file", type=Path, help="CSV, for ./surg calibrate CELL ... --from FILE")
    parser.add_argument("--arm", help="default: the cell's first")
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--count", type=int, default=12, help="poses of each motion")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(words)
    try:
        cell = surg_core.load_cell(options.cell)
        if options.arm is not None and options.arm not in cell.arms:
            raise ValueError(f"--arm {options.arm}: the cell has {', '.join(cell.arms)}")
        Bench(cell, options.seed, options.arm).record(options.file, options.motions, options.count)
    except (ValueError, OSError, RuntimeError) as error:
        print(f"surg_sim.physics.calibration_bench: {error}", file=sys.stderr)
        return 2
    print(f"{options.file}: {options.count} poses each of {', '.join(options.motions)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
