"""Estimates the forces at tip and trocar from a stream of readings; values in, values out.

A moving window averages what is left of the readings without the tool's weight. Over the same
window the mean inertial force is exactly mass times the change of the centre's velocity, so nothing
is differentiated. The estimate belongs to the window's middle.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from surg_core.force.compensation import (
    ToolLoad,
    cross,
    external_jacobian,
    external_wrench,
    moved,
)
from surg_core.force.sensor_file import ForceSensor
from surg_core.force.split import ShaftForces, pivot_jacobian, split, split_matrix
from surg_core.transforms import FloatArray, skew

OK = "ok"
FILLING = "filling"
NEAR_TROCAR = "near_trocar"
SATURATED = "saturated"
NOT_FINITE = "not_finite"
REASONS = (OK, FILLING, NEAR_TROCAR, SATURATED, NOT_FINITE)
"""Why there is no estimate: the window fills after a start or a gap; the tip is so close to the
trocar that the split is singular; a reading is outside the sensor's range, or not a number."""
BAD_SENSOR = (SATURATED, NOT_FINITE)

WINDOW = 0.016
"""[s] Length of the window; its middle is half of that old."""
LEAST_DEPTH = 0.010
"""[m] Shallower, tip and trocar are one contact."""
MOST_SD = 0.5
"""[N] Standard deviation of the tip's force above which the estimate is not valid; assumed, a tenth
of the force at which the guard yields."""
LOAD_RATE = 5.0
"""[N/s] rms change of a force, by which the window's age becomes an error; assumed."""
DEPTH_SD = 0.001
"""[m] How well the trocar's place along the shaft is known; assumed."""
SHAFT_SD = 0.0003
"""[m] How far the true shaft passes beside the calibrated one; assumed, as the in vivo setting."""
VELOCITY_SD = 0.0005
"""[m/s] Of the centre of mass by measured joint velocities; assumed."""


@dataclass(frozen=True, eq=False)
class ForceEstimate:
    """What a window of readings says.

    Attributes:
        reason: One of :data:`REASONS`; the others are None unless it is ``ok`` or ``near_trocar``.
        stamp: Middle of the window [s].
        forces: In the axes of the robot's base; at ``near_trocar`` only ``total`` means anything.
        covariance: (7, 7) of tip, trocar and axial sum [N^2].
        total: (3,) sum of both forces on the instrument [N], always well determined.
    """

    reason: str
    stamp: float = 0.0
    forces: ShaftForces | None = None
    covariance: FloatArray | None = None
    total: FloatArray | None = None

    @property
    def valid(self) -> bool:
        """Whether both lateral forces are known."""
        return self.reason == OK


@dataclass(frozen=True, eq=False)
class _Sample:
    """A reading with the arm's state; vectors in the base's axes."""

    stamp: float
    reading: FloatArray  # (6,) in the sensor's axes
    wrench: FloatArray  # (6,) about the trocar's point on the shaft, without weight
    velocity: FloatArray  # (3,) of the centre of mass [m/s]
    R_BF: FloatArray  # (3, 3)
    s: FloatArray  # (3,) shaft axis
    depth: float  # of the tip [m]
    lever: FloatArray  # (3,) from the trocar's point on the shaft to the sensor [m]
    arm: FloatArray  # (3,) from there to the centre of mass [m]


@dataclass(eq=False)
class ForceEstimator:
    """Forces of one arm's instrument.

    Attributes:
        load: As calibrated.
        sensor: Its range and noise.
        s_F, p_FTip: (3,) calibrated shaft axis and tip [m] in the flange.
        g_B: (3,) gravity in the base [m/s^2].
        window: [s].
        hours: Since the sensor was zeroed; its drift grows with their root.
    """

    load: ToolLoad
    sensor: ForceSensor
    s_F: FloatArray
    p_FTip: FloatArray
    g_B: FloatArray
    window: float = WINDOW
    hours: float = 0.0
    _samples: deque[_Sample] = field(default_factory=deque)
    _fault: str = OK

    def __post_init__(self) -> None:
        """Derive what does not change."""
        self._period = 1.0 / self.sensor.rate
        self._n = max(2, round(self.window * self.sensor.rate))
        self._p_FCom = self.load.p_FS + self.load.R_FS @ self.load.p_SCom

    def reset(self) -> None:
        """Forget the window."""
        self._samples.clear()

    def add(
        self,
        stamp: float,
        reading: FloatArray,
        X_BF: FloatArray,
        twist: FloatArray,
        p_BRcm: FloatArray,
    ) -> str:
        """Take a reading and the arm's state at its time; returns ``ok`` or what is wrong with it.

        Args:
            stamp: Of the reading [s]; a gap of more than two periods empties the window.
            reading: (6,) of the sensor, in its axes.
            X_BF: (4, 4) flange in the base.
            twist: (6,) of the flange, v [m/s] and omega [rad/s], at its origin, in the base.
            p_BRcm: (3,) trocar in the base, tracked where it moves [m].
        """
        self._fault = self._problem(reading, X_BF, twist, p_BRcm)
        if self._fault != OK:
            self.reset()
            return self._fault
        samples = self._samples
        if samples and not 0.0 < stamp - samples[-1].stamp < 2.5 * self._period:
            self.reset()
        R, p = X_BF[:3, :3], X_BF[:3, 3]
        s, tip = R @ self.s_F, p + R @ self.p_FTip
        depth = float(s @ (tip - p_BRcm))
        near = tip - depth * s
        lever = p + R @ self.load.p_FS - near
        r_Com = R @ self._p_FCom
        samples.append(
            _Sample(
                stamp=stamp,
                reading=reading,
                wrench=moved(external_wrench(self.load, reading, R, self.g_B), lever),
                velocity=twist[:3] + cross(twist[3:], r_Com),
                R_BF=R,
                s=s,
                depth=depth,
                lever=lever,
                arm=p + r_Com - near,
            )
        )
        if len(samples) > self._n:
            samples.popleft()
        return OK

    def estimate(self) -> ForceEstimate:
        """What the readings so far say."""
        samples = self._samples
        if len(samples) < self._n:
            return ForceEstimate(FILLING if self._fault == OK else self._fault)
        first, last = samples[0], samples[-1]
        span = last.stamp - first.stamp
        mean = np.mean([each.wrench for each in samples], axis=0)
        force = (last.velocity - first.velocity) * (self.load.mass / span)
        mean += np.concatenate([force, cross(last.arm, force)])
        stamp, total = first.stamp + 0.5 * span, mean[:3]
        if last.depth < LEAST_DEPTH:
            return ForceEstimate(NEAR_TROCAR, stamp, total=total)
        forces = split(mean, last.s, last.depth)
        C = self._covariance(forces, last, span)
        sd = np.sqrt(np.trace(C[:3, :3]) / 2.0)
        return ForceEstimate(OK if sd <= MOST_SD else NEAR_TROCAR, stamp, forces, C, total)

    def _problem(self, reading: FloatArray, *others: FloatArray) -> str:
        if not (np.isfinite(reading).all() and all(np.isfinite(each).all() for each in others)):
            return NOT_FINITE
        return SATURATED if (np.abs(reading) >= self.sensor.largest).any() else OK

    def _covariance(self, forces: ShaftForces, last: _Sample, span: float) -> FloatArray:
        """(7, 7) of (tip, trocar, axial): noise, drift, load, trocar, velocity and age."""
        shift = np.eye(6)
        shift[3:, :3] = skew(last.lever)
        M = split_matrix(forces.s, forces.depth)
        turn = np.kron(np.eye(2), last.R_BF @ self.load.R_FS)
        by_reading = M @ shift @ turn
        variance = self.sensor.noise**2 / self._n + self.sensor.drift**2 * self.hours
        by_load = M @ shift @ external_jacobian(self.load, last.reading, last.R_BF, self.g_B)
        along = np.outer(forces.s, forces.s)
        where = DEPTH_SD * along + SHAFT_SD * (np.eye(3) - along)
        by_pivot = pivot_jacobian(forces) @ where
        by_inertia = M @ np.vstack([np.eye(3), skew(last.arm)])
        by_inertia *= np.sqrt(2.0) * VELOCITY_SD * self.load.mass / span
        roots = np.hstack([by_reading * np.sqrt(variance), by_pivot, by_inertia])
        C: FloatArray = np.matmul(roots, roots.T)
        C = C + np.matmul(by_load @ self.load.covariance, by_load.T)
        late = (0.5 * LOAD_RATE * span) ** 2
        C[:3, :3] += late * (np.eye(3) - along)
        C[3:6, 3:6] += late * (np.eye(3) - along)
        C[6, 6] += late
        return C
