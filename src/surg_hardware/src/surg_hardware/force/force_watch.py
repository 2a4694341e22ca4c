"""Decides what the force guards are told: an estimate, or that it is not known, and why.

Values in, values out; times are arguments.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core.force import estimator as estimators
from surg_core.force.compensation import gravity_in_base
from surg_core.force.estimator import ForceEstimator
from surg_core.force.force_file import check_current, load_force
from surg_core.force.sensor_file import load_sensor

Array = NDArray[np.float64]

SILENT_S = 0.1
"""[s] A sensor or a joint state that is older is lost; the controller waits 0.2 s for a force. A
busy machine without real-time priority holds a process up for 20 to 65 ms (measured)."""

SENTENCES = {
    estimators.OK: "ok",
    estimators.FILLING: "the window of readings fills",
    estimators.NEAR_TROCAR: "the tip is too near to the trocar to tell both forces apart",
    estimators.SATURATED: "the sensor is saturated: it reads its range. Unload it",
    estimators.NOT_FINITE: "the sensor gives no number: look at its driver",
    "silent": "the sensor is silent: look at its driver, which publishes flange/measured_cf",
    "no_joints": "the robot's joint state is silent",
}


@dataclass(frozen=True, eq=False)
class Told:
    """What is published.

    Attributes:
        reason: A key of :data:`SENTENCES`, or ``stale``.
        sentence: For people.
        stamp: Of the estimate [s].
        tip: (3,) lateral force on the tip and the whole axial sum, base axes [N]; None: not known.
        trocar: (3,) lateral force of the shaft on the trocar, base axes [N]; None: not known.
    """

    reason: str
    sentence: str
    stamp: float = 0.0
    tip: Array | None = None
    trocar: Array | None = None


class ForceWatch:
    """One arm's sensor.

    Args:
        cell: Loaded.
        name: Of the arm.
        now: Date and time, UTC.

    Raises:
        ConfigError: The cell has no sensor, or a file is missing or wrong.
    """

    def __init__(self, cell: surg_core.Cell, name: str, now: datetime.datetime) -> None:
        arm = cell.arms[name]
        if arm.force_sensor is None:
            raise surg_core.ConfigError(
                f"{cell.folder}/force_sensor_{name}.yaml: no such file; it states the sensor"
            )
        self._arm, self._folder = arm, cell.folder
        self._sensor_file = arm.force_sensor
        self.sensor = load_sensor(arm.force_sensor)
        self._file = cell.folder / "calibration" / f"force_{name}.yaml"
        self._found = load_force(self._file)
        self._estimator = ForceEstimator(
            self._found.load,
            self.sensor,
            arm.tool.s_F,
            arm.tool.p_FTip,
            gravity_in_base(arm.X_WB[:3, :3]),
            hours=self._found.hours_since_zero(now),
        )
        self._p_BRcm: Array = np.array(arm.trocar.p_BRcm)
        self._joints: tuple[float, Array, Array] | None = None
        self._stale = ""
        self._said = estimators.FILLING
        self._read: float | None = None
        self.mount(cell.folder / "calibration" / f"tool_{name}.yaml")

    def mount(self, tool_file: Path) -> None:
        """Another tool's calibration is in force; a load that is older is not used."""
        try:
            check_current(self._found, self._file, tool_file, self._sensor_file)
        except surg_core.ConfigError as error:
            self._stale = str(error)
        else:
            self._stale = ""

    def joints(self, now: float, q: Array, qd: Array) -> None:
        """Take the robot's joint state, (n,) [rad] and [rad/s]; now [s] on a steady clock."""
        self._joints = (now, q, qd)

    def trocar(self, p_BRcm: Array) -> None:
        """Take the pivot (3,) in the base [m]."""
        self._p_BRcm = p_BRcm

    def reading(self, now: float, stamp: float, reading: Array) -> None:
        """Take a reading (6,) as the sensor gives it, with its stamp [s]."""
        self._read = now
        if self._joints is None or now - self._joints[0] > SILENT_S:
            self._estimator.reset()
            return
        _, q, qd = self._joints
        chain = self._arm.chain
        twist = chain.jacobian(q) @ qd
        signed = self.sensor.sign * reading
        self._said = self._estimator.add(stamp, signed, chain.forward(q), twist, self._p_BRcm)

    def tell(self, now: float) -> Told:
        """What the guards are told now [s]."""
        if self._stale:
            return Told("stale", self._stale)
        if self._read is None or now - self._read > SILENT_S:
            self._estimator.reset()
            return _unknown("silent")
        if self._joints is None or now - self._joints[0] > SILENT_S:
            return _unknown("no_joints")
        if self._said in estimators.BAD_SENSOR:
            return _unknown(self._said)
        estimate = self._estimator.estimate()
        forces = estimate.forces
        if not estimate.valid or forces is None:
            return _unknown(estimate.reason)
        tip = forces.tip + forces.axial * forces.s
        return Told("ok", "ok", estimate.stamp, tip, -forces.trocar)


def _unknown(reason: str) -> Told:
    return Told(reason, SENTENCES[reason])
