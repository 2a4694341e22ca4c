"""A six-axis force sensor between the flange and the tool of a simulated arm.

The truth is MuJoCo's interaction force between the flange and the bodies that hang on it; it holds
weight, inertia and every contact. Noise, bias, drift and saturation are the sensor file's. Reading
it changes nothing in the simulation.
"""

from __future__ import annotations

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_core.force.sensor_file import ForceSensor, load_sensor
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import robot_part


def sensor_of(arm: surg_core.Arm) -> ForceSensor | None:
    """What the arm's cell states of its sensor; None: it has none.

    Raises:
        ConfigError: The sensor's file is wrong.
    """
    return None if arm.force_sensor is None else load_sensor(arm.force_sensor)


def true_frame(sensor: ForceSensor) -> tuple[Array, Array]:
    """R_FS (3, 3) and p_FS (3,) as the simulated sensor is mounted, otherwise than drawn."""
    angle = float(np.linalg.norm(sensor.turn))
    R = sensor.X_FS[:3, :3]
    if angle > 0.0:
        R = R @ surg_core.axis_angle_to_matrix(sensor.turn / angle, angle)
    return R, sensor.X_FS[:3, 3]


class FlangeSensor:
    """The sensor of one arm in a compiled scene.

    Args:
        model: The compiled scene.
        data: Its state.
        arm: Of the cell.
        sensor: What the sensor's file states.
        seed: Of noise and drift.
        in_patient: Whether the trocar's sleeve presses on the shaft; False: the tool is on a bench.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: surg_core.Arm,
        sensor: ForceSensor,
        seed: int,
        in_patient: bool = True,
    ) -> None:
        self._model, self._data, self._sensor = model, data, sensor
        flange = model.body(robot_part(arm, arm.robot.flange_link)).id
        sleeve = model.body(f"{arm.name}/sleeve").id
        held = [i for i in range(model.nbody) if model.body_parentid[i] == flange]
        self._tool = [i for i in held if i != sleeve]
        self._sleeve = [sleeve] if in_patient else []
        self._flange, self._root = flange, int(model.body_rootid[flange])
        self._R_FS, self._p_FS = true_frame(sensor)
        self._spatial = np.empty(6)
        self._seed = seed
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """A fresh zero, without drift; None: the seed it was made with."""
        self._rng = np.random.default_rng([self._seed if seed is None else seed, 0xF0])
        self._drift = np.zeros(6)
        self.reading: Array = np.array(self._sensor.bias)
        """(6,) The newest reading [N, N m], with the sign of the sensor's file."""

    def sample(self) -> None:
        """Read once a tick, after ``mj_rnePostConstraint`` has computed the step's forces."""
        sensor, rng = self._sensor, self._rng
        self._drift += sensor.drift * np.sqrt(TICK / 3600.0) * rng.normal(size=6)
        raw = self.truth() + sensor.bias + self._drift + sensor.noise * rng.normal(size=6)
        self.reading = sensor.sign * np.clip(raw, -sensor.largest, sensor.largest)

    def truth(self) -> Array:
        """(6,) What the tool exerts on the sensor, without any error, at the last sample."""
        data = self._data
        R_WF = data.xmat[self._flange].reshape(3, 3)
        origin = data.xpos[self._flange] + R_WF @ self._p_FS
        # The sleeve's weight and inertia are the wall's: only what the wall exerts on it counts.
        total = data.cfrc_int[self._tool].sum(axis=0) - data.cfrc_ext[self._sleeve].sum(axis=0)
        centre = data.subtree_com[self._root]
        mujoco.mju_transformSpatial(
            self._spatial, total, 1, origin, centre, np.ascontiguousarray(R_WF @ self._R_FS).ravel()
        )
        return -np.concatenate([self._spatial[3:], self._spatial[:3]])
