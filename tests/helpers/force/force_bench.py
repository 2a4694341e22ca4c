"""A bench for a tool on its force sensor: postures of the free tool, as a recording.

::

    python3 tests/helpers/force/force_bench.py CELL FILE.csv
    ./surg calibrate CELL force --from FILE.csv

The tool hangs in the room, at rest; encoders and sensor have their noise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

import surg_core
from surg_core.force import force_recording
from surg_core.force.sensor_file import ForceSensor
from surg_sim.arrays import Array
from surg_sim.physics.calibration_bench import ENCODER_SIGMA
from surg_sim.physics.world import World
from surg_sim.sensing.flange_sensor import FlangeSensor, sensor_of

READINGS = 250
"""In each mean: half a second."""
TURN = 1.3
"""[rad] Largest turn of each of the last three joints from home."""


class ForceBench:
    """One arm of a cell with its sensor, outside any patient.

    Raises:
        ValueError: The cell states no force sensor for the arm.
    """

    def __init__(self, cell: surg_core.Cell, arm: str, seed: int) -> None:
        self.arm = cell.arms[arm]
        sensor = sensor_of(self.arm)
        if sensor is None:
            raise ValueError(
                f"{cell.folder}/force_sensor_{arm}.yaml: no such file; it states the sensor"
            )
        self.sensor: ForceSensor = sensor
        world = World(cell, arms=[arm])
        self._model, self._data = world.model, mujoco.MjData(world.model)
        self._flange = FlangeSensor(self._model, self._data, self.arm, sensor, seed, False)
        self._tip = self._model.body(f"{arm}_{self.arm.instrument.tip_link}").id
        joints = [self._model.joint(f"{arm}_robot_{name}") for name in self.arm.robot.joint_names]
        self._qpos = [joint.qposadr[0] for joint in joints]
        self._rng = np.random.default_rng(seed)

    def draw(self) -> Array:
        """Joint positions (n,): the last three are turned from home."""
        q = np.array(self.arm.robot.home)
        q[-3:] += self._rng.uniform(-TURN, TURN, 3)
        return np.clip(q, self.arm.robot.position_min, self.arm.robot.position_max)

    def reading(self, q: Array, push: Array | None = None) -> Array:
        """(6,) mean of :data:`READINGS` readings at rest; push (3,) on the tip, world [N]."""
        data, sensor = self._data, self.sensor
        data.qpos[self._qpos] = q
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_comVel(self._model, data)
        # MuJoCo applies a force at the body's centre of mass, which a tip without mass has not.
        force = np.zeros(3) if push is None else push
        lever = data.xpos[self._tip] - data.xipos[self._tip]
        data.xfrc_applied[self._tip] = np.concatenate([force, np.cross(lever, force)])
        mujoco.mj_rnePostConstraint(self._model, data)
        noise = sensor.noise / np.sqrt(READINGS) * self._rng.normal(size=6)
        return sensor.sign * (self._flange.truth() + sensor.bias + noise)

    def record(self, path: Path, count: int, push: Array | None = None) -> None:
        """Write a recording of ``count`` postures; push (3,) presses on the tip in the last."""
        lines = [force_recording.header(self.arm.robot.joint_names)]
        for k in range(count):
            q = self.draw()
            reading = self.reading(q, push if k == count - 1 else None)
            measured = q + self._rng.normal(scale=ENCODER_SIGMA, size=len(q))
            lines.append(force_recording.row(measured, reading, READINGS))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main(words: Sequence[str] | None = None) -> int:
    """Record a free tool in many postures."""
    parser = argparse.ArgumentParser(prog="force_bench.py", description=main.__doc__)
    parser.add_argument("cell", type=Path)
    parser.add_argument("file", type=Path, help="CSV, for ./surg calibrate CELL force --from FILE")
    parser.add_argument("--arm", help="default: the cell's first")
    parser.add_argument("--count", type=int, default=16, help="postures (default 16)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--push", type=float, metavar="N", help="press on the tip in the last one")
    options = parser.parse_args(words)
    try:
        cell = surg_core.load_cell(options.cell)
        name = options.arm or next(iter(cell.arms))
        if name not in cell.arms:
            raise ValueError(f"--arm {name}: the cell has {', '.join(cell.arms)}")
        push = None if options.push is None else np.array([0.0, 0.0, options.push])
        ForceBench(cell, name, options.seed).record(options.file, options.count, push)
    except (ValueError, OSError) as error:
        print(f"force_bench.py: {error}", file=sys.stderr)
        return 2
    print(f"{options.file}: {options.count} postures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
