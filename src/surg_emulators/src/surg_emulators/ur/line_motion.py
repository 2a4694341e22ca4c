"""Motion of the tool along a line (`movel`) or circle (`movec`), as a command of the joints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import FASTEST, SHARPEST, Vector, approach, turned

DAMPING = 1e-8
"""Keeps a singularity finite; elsewhere it is not seen."""
AHEAD = 0.01
"""How far ahead on its circle the tool aims [rad]."""


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

    @staticmethod
    def extent(twist: dh.Matrix) -> float:
        """The larger one of a translation [m] and a rotation [rad]."""
        return max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`; it aims at the goal anew in every cycle."""
        way = self.way(q)
        distance = self.extent(way)
        if distance < 1e-9:
            return [0.0] * 6
        J = dh.jacobian(q, self.table, self.X_FTcp)
        found = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), way / distance)
        # Of a joint, at 1 m/s or rad/s of the tool.
        most = max(1e-9, float(np.abs(found).max()))
        a, v = min(self.a, SHARPEST / most), min(self.v, FASTEST / most)
        speed = approach(distance, self.extent(J @ np.array(qd)), a, v, dt)
        rates = [float(rate) for rate in speed * found]
        return turned(rates, qd, dt) if self.turns else rates


@dataclass(frozen=True, kw_only=True)
class Arc(Line):
    """Go to a pose along a circle.

    Attributes:
        centre: Of the circle in `base`, (3,) [m].
        axis: About which it turns, (3,), of length 1.
        fixed: Whether the orientation keeps to the circle's tangent, not to the goal's.
    """

    centre: dh.Matrix
    axis: dh.Matrix
    fixed: bool = False

    @staticmethod
    def extent(twist: dh.Matrix) -> float:
        """The translation [m]: a circle's speed is the tool's alone."""
        return float(np.linalg.norm(twist[:3]))

    def way(self, q: Vector) -> dh.Matrix:
        """What is left: the length along the circle, in the direction in which to go, and turn."""
        left = super().way(q)
        goal, here = self.X_BTcp[:3, 3] - self.centre, self.X_BTcp[:3, 3] - left[:3] - self.centre
        angle = math.atan2(self.axis @ np.cross(here, goal), here @ goal) % math.tau
        angle = 0.0 if angle > math.tau - AHEAD else angle  # a little too far
        if angle > AHEAD:
            aim = dh.rotation_matrix(list(self.axis * (AHEAD - angle))) @ goal - here
            left[:3] = aim * (angle * np.linalg.norm(goal) / np.linalg.norm(aim))
        if self.fixed:
            left[3:] = self.axis * angle
        return left


def circle(start: dh.Matrix, via: dh.Matrix, goal: dh.Matrix) -> dict[str, dh.Matrix]:
    """Centre and axis of the circle from one point by another to a third, each (3,) [m].

    Raises:
        ZeroDivisionError: They lie on a line.
    """
    a, b = via - start, goal - start
    n = np.cross(a, b)
    size = float(n @ n)
    if size < 1e-15:
        raise ZeroDivisionError("movec: the three points lie on a line")
    centre = start + ((a @ a) * np.cross(b, n) + (b @ b) * np.cross(n, a)) / (2.0 * size)
    return {"centre": centre, "axis": n / math.sqrt(size)}
