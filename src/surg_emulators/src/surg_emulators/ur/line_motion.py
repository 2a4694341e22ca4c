"""Motion of the tool along a straight line (`movel`), as a command of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import Vector, approach, turned

DAMPING = 1e-8
"""Keeps a singularity finite; elsewhere it is not seen."""


@dataclass(frozen=True)
class Line:
    """Go to a pose in a straight line, while the orientation turns about one axis.

    Attributes:
        X_BTcp: Goal of the tool centre point in `base`, (4, 4).
        a: Acceleration of the tool [m/s^2]; where it turns further than it moves, [rad/s^2].
        v: Speed of the tool [m/s or rad/s].
        table: d [m], a [m], alpha [rad] of each joint.
        X_FTcp: Tool centre point in the flange, (4, 4).
        turns: Whether the arm still moves from the move before.
    """

    X_BTcp: dh.Matrix
    a: float
    v: float
    table: dh.Table
    X_FTcp: dh.Matrix
    turns: bool = False

    def way(self, q: Vector) -> dh.Matrix:
        """What is left: translation [m] and rotation vector [rad], (6,)."""
        X = dh.frames(q, self.table)[-1] @ self.X_FTcp
        turn = dh.rotation_vector(self.X_BTcp[:3, :3] @ X[:3, :3].T)
        return np.r_[self.X_BTcp[:3, 3] - X[:3, 3], turn]

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`; it aims at the goal anew in every cycle."""
        way = self.way(q)
        distance = extent(way)
        if distance < 1e-9:
            return [0.0] * 6
        J = dh.jacobian(q, self.table, self.X_FTcp)
        speed = approach(distance, extent(J @ np.array(qd)), self.a, self.v, dt)
        wanted = way * (speed / distance)
        found = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), wanted)
        rates = [float(rate) for rate in found]
        return turned(rates, qd, dt) if self.turns else rates


def extent(twist: dh.Matrix) -> float:
    """The larger one of a translation [m] and a rotation [rad]."""
    return max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
