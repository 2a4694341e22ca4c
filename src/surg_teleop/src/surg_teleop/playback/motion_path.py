"""The path of a planned motion over time: run-in, recorded motion and its repetitions, run-out."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Slerp

from surg_core.arm_view import Array
from surg_teleop.playback.motion_file import Motion
from surg_teleop.playback.quintic import Quintic, horner
from surg_teleop.playback.workspace_fit import Workspace


@dataclass(frozen=True)
class MotionPlan:
    """Path of an arm over time, in the rcm frame; made by :func:`motion_plan.make_plan`.

    Attributes:
        scale: Arm metres per metre of the motion.
        p_0: (3,) of the motion [m], which lies at p_R0 (3,) in the rcm frame [m].
        roll_0: Roll of the motion that is roll 0 of the arm [rad].
        run_in: Length of the run-in [s].
        played: Length of the played window [s]: run_in to run_in + played is recorded motion.
        run_out: Length of the run-out [s].
        back: Length of the return between two repetitions [s].
    """

    motion: Motion
    workspace: Workspace
    scale: float
    p_0: Array
    p_R0: Array
    roll_0: float
    run_in: float
    played: float
    run_out: float
    back: float
    _spline: CubicSpline
    _in: Quintic
    _back: Quintic
    _out: Quintic
    _gripper_closed: float
    _knots: list[float]
    _pieces: list[Array]
    _turns: Slerp | None

    @property
    def duration(self) -> float:
        """Total length [s]."""
        return self.run_in + self.played + self.run_out

    @property
    def window(self) -> tuple[float, float]:
        """Start and end of the recorded motion within the plan [s]."""
        return self.run_in, self.run_in + self.played

    def at(self, t: float) -> tuple[Array, float]:
        """Tip (3,) [m] and roll [rad] at a time [s] since the start; at rest beyond both ends."""
        t = min(max(t, 0.0), self.duration)
        start, end = self.window
        if t < start:
            state = horner(self._in.coefficients, t)
        elif t >= end:
            state = horner(self._out.coefficients, t - end)
        else:
            local = self._phase_at(t)
            if local > self.motion.duration:
                state = horner(self._back.coefficients, local - self.motion.duration)
            else:
                piece = min(bisect.bisect_right(self._knots, local), len(self._knots) - 1) - 1
                state = horner(self._pieces[piece], local - self._knots[piece])
        return self._placed(state[:3]), float(state[3]) - self.roll_0

    def turn(self, t: float) -> Array | None:
        """Rotation (3, 3) of the tool at a time [s], in the rcm frame; None: the file has none.

        Run-in and run-out do not turn.
        """
        if self._turns is None:
            return None
        phase = (
            self._phase_at(t)
            if t < self.window[1]
            else end_phase(self.motion, self.played, self.back)
        )
        return np.asarray(self._turns(phase).as_matrix())

    def path(self, t: Array) -> tuple[Array, Array]:
        """The same for times (n,): tips (n, 3) [m] and rolls (n,) [rad]."""
        t = np.clip(t, 0.0, self.duration)
        state = np.empty((len(t), 4))
        first = t < self.run_in
        last = t >= self.run_in + self.played
        middle = ~(first | last)
        state[first] = self._in.at(t[first])
        state[last] = self._out.at(t[last] - self.run_in - self.played)
        local = self._phase(t[middle])
        recorded = local <= self.motion.duration
        inside = np.empty((len(local), 4))
        inside[recorded] = self._spline(local[recorded])
        inside[~recorded] = self._back.at(local[~recorded] - self.motion.duration)
        state[middle] = inside
        return self._placed(state[:, :3]), state[:, 3] - self.roll_0

    def opening(self, t: float) -> float | None:
        """Gripper opening [rad] at a time [s]; None without a gripper.

        Relative to the most closed sample, because the zero of recordings is arbitrary.
        """
        local = self._phase_at(min(max(t, 0.0), self.duration))
        value = self.motion.gripper_at(min(local, self.motion.duration))
        return None if value is None else value - self._gripper_closed

    def place(self, t: float) -> str:
        """File and line of a time [s] since the start, for messages."""
        start, end = self.window
        if start <= t <= end:
            sample = int(np.argmin(np.abs(self.motion.t - self._phase_at(t))))
            return f"{self.motion.file}: line {self.motion.lines[sample]}"
        return f"{self.motion.file}: on the way {'in' if t < start else 'out'}"

    def _placed(self, p: Array) -> Array:
        """Positions (..., 3) of the motion in the rcm frame [m]."""
        return self.p_R0 + self.scale * (p - self.p_0)

    def _phase(self, t: Array) -> Array:
        """Time within one repetition [s] for times since the start of the plan."""
        window = np.clip(t - self.run_in, 0.0, self.played)
        period = self.motion.duration + self.back
        phase: Array = window - period * np.floor(window / period)
        return phase

    def _phase_at(self, t: float) -> float:
        window = min(max(t - self.run_in, 0.0), self.played)
        period = self.motion.duration + self.back
        return window - period * math.floor(window / period)


def end_phase(motion: Motion, played: float, back: float) -> float:
    """Time within one repetition [s] at which the played window ends."""
    return math.fmod(played, motion.duration + back) if back else motion.duration
