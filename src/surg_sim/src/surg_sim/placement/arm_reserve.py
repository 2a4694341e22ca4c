"""How much of its joint range, speed and acceleration an arm has left in a workspace."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_core.transforms import minimal_rotation
from surg_sim.arrays import Array
from surg_sim.physics.trocar import shaft_in_flange


@dataclass(frozen=True)
class Workspace:
    """What an arm must be able to do around its home posture."""

    depth: float  # of the tip behind the trocar at home [m]
    # Half sides of the box that the tip must reach, across and along the shaft, (3,) [m].
    box: tuple[float, float, float]
    roll: float  # largest roll in either direction [rad]
    speed: float  # tip speed at which joint speeds are judged [m/s]
    roll_speed: float  # roll speed in addition to it [rad/s]
    acceleration: float  # tip acceleration at which joint accelerations are judged [m/s^2]


INSTRUMENT = Workspace(0.120, (0.035, 0.035, 0.030), 1.0, 0.12, 1.0, 2.0)
"""Covers the bundled motions."""
ENDOSCOPE = Workspace(0.060, (0.015, 0.015, 0.020), 0.6, 0.03, 0.3, 0.3)
"""Aims at any point of the instrument's box, 18 degrees to each side, slowly."""


@dataclass(frozen=True)
class Reserve:
    """Worst values of an arm over the corners of its workspace."""

    margin: float  # smallest distance of a joint from its limit [rad]
    speed: float  # largest share of a joint's velocity limit
    acceleration: float  # largest share of a joint's acceleration limit at the tip's own
    singular: float  # smallest singular value of the flange Jacobian
    postures: Array  # (m, n) the joint positions of the corners [rad]

    @property
    def score(self) -> float:
        """Figure of merit, the weakest of all criteria; larger is better."""
        return min(
            1.0 - self.speed, 1.0 - self.acceleration / 1.6, self.margin, 2.5 * self.singular
        )


def inverse(chain: surg_core.Chain, start: Array, X: Array, steps: int = 60) -> Array | None:
    """Joint positions (n,) with the flange at X (4, 4), by Newton steps; None: not found."""
    q = start.copy()
    for _ in range(steps):
        present = np.asarray(chain.forward(q))
        turn = X[:3, :3] @ present[:3, :3].T
        w = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        if np.trace(turn) < 1.0:  # beyond 90 degrees the sine falls again
            w /= max(float(np.linalg.norm(w)), 1e-9)
        error = np.concatenate([X[:3, 3] - present[:3, 3], w])
        if np.abs(error).max() < 1e-10:
            return q
        J = np.asarray(chain.jacobian(q))
        step = J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(6), error)
        q = q + step * min(1.0, 0.4 / float(np.abs(step).max()))
    return None


def reserve(arm: surg_core.Arm, q_home: Array, workspace: Workspace) -> Reserve | None:
    """Reserve of an arm around a home posture (n,) [rad]; None: a corner is out of reach.

    The arm's tool and limits count, its trocar does not.
    """
    depth = workspace.depth
    p_FTip, s_F = shaft_in_flange(arm)
    robot, X_home = arm.robot, np.asarray(arm.chain.forward(q_home))
    R_home, s = X_home[:3, :3], X_home[:3, :3] @ s_F
    p_Rcm = R_home @ p_FTip + X_home[:3, 3] - depth * s
    low, high = np.asarray(robot.position_min), np.asarray(robot.position_max)
    x = np.cross(s, [0.0, 1.0, 0.0])
    R_BR = np.column_stack([x / np.linalg.norm(x), np.cross(s, x / np.linalg.norm(x)), s])
    postures, margin, singular, speed, acceleration = [], np.inf, np.inf, 0.0, 0.0
    for signs in itertools.product((-1, 1), repeat=3):
        corner = R_BR @ (np.array([0.0, 0.0, depth]) + np.array(signs) * workspace.box)
        for roll in (-workspace.roll, 0.0, workspace.roll):
            q = q_home
            for share in (0.5, 1.0):
                p = (1 - share) * depth * s + share * corner
                axis = p / np.linalg.norm(p)
                R = minimal_rotation(s, axis) @ axis_angle_to_matrix(s, share * roll) @ R_home
                X = surg_core.make_pose(p_Rcm + p - R @ p_FTip, R)
                reached = inverse(arm.chain, q, X, 20)
                if reached is None:
                    return None
                q = reached
            postures.append(q)
            J = np.asarray(arm.chain.jacobian(q))
            singular = min(singular, float(np.linalg.svd(J, compute_uv=False)[5]))
            margin = min(margin, float(np.minimum(q - low, high - q).min()))
            # Flange twists of unit tip velocities and of unit roll about the shaft.
            L, r = float(np.linalg.norm(p)), X[:3, 3] - p_Rcm
            W = np.array([np.cross(axis, e) / L for e in np.eye(3)])
            V = np.array([(axis @ e) * axis for e in np.eye(3)]) + np.cross(W, r)
            back = np.linalg.pinv(J)
            rows = np.linalg.norm(back @ np.vstack((V.T, W.T)), axis=1)
            rolls = np.abs(back @ np.concatenate((np.cross(axis, r), axis)))
            velocity = workspace.speed * rows + workspace.roll_speed * rolls
            speed = max(speed, float((velocity / robot.velocity).max()))
            share = float((workspace.acceleration * rows / robot.acceleration).max())
            acceleration = max(acceleration, share)
    return Reserve(margin, speed, acceleration, singular, np.array(postures))
