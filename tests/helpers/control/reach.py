"""Numerical inverse kinematics over a box round the home tip: what an arm's home posture is worth.

Independent of the core's solvers: a Jacobian by finite differences, Newton's method.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surg_core import Chain, chain_from_urdf
from surg_description.make_cell import home_pose

Matrix = NDArray[np.float64]
BOX = (0.035, 0.035, 0.030)
ROLLS = (-1.0, 0.0, 1.0)
TIP_SPEED = 0.12
ROLL_RATE = 1.0


@dataclass(frozen=True)
class Reach:
    """The worst over the box.

    Attributes:
        tilt_deg: Angle of the home shaft from straight down [deg].
        joint_margin: Smallest distance to a joint limit [rad].
        singular_value: Smallest singular value of the flange Jacobian.
        velocity: Largest share of a joint's velocity limit at TIP_SPEED and ROLL_RATE.
        acceleration: Largest share of a joint's acceleration limit at the tip's own.
        flange_velocity: Fastest flange at TIP_SPEED [m/s].
    """

    tilt_deg: float
    joint_margin: float
    singular_value: float
    velocity: float
    acceleration: float
    flange_velocity: float


def sweep(robot_yaml: Path, instrument_yaml: Path, depth: float) -> Reach:
    """Solves the corners of the box at three rolls."""
    robot = yaml.safe_load(robot_yaml.read_text())
    joints = robot["joints"]
    q_home, low, high, v_max, a_max = (
        np.array(joints[key], dtype=float)
        for key in ("home", "position_min", "position_max", "velocity", "acceleration")
    )
    chain = chain_from_urdf(
        robot_yaml.parent / robot["urdf"], robot["base_link"], robot["flange_link"], joints["names"]
    )
    home = home_pose(robot_yaml, instrument_yaml, depth)
    x = np.array([1.0, 0.0, 0.0]) - home.s_B[0] * home.s_B
    x /= np.linalg.norm(x)
    R_BR = np.column_stack((x, np.cross(home.s_B, x), home.s_B))
    margin = singular = np.inf
    speed = acceleration = flange = 0.0
    for signs in itertools.product((-1, 1), repeat=3):
        corner = np.array([0, 0, depth]) + np.array(signs) * BOX
        for roll in ROLLS:
            q = q_home
            for share in (0.5, 1.0):
                p = (1 - share) * np.array([0, 0, depth]) + share * corner
                s = R_BR @ (p / np.linalg.norm(p))
                axis = np.cross(home.s_B, s)  # the minimal rotation turns about it
                swing = np.arcsin(np.linalg.norm(axis))
                turn = Rotation.from_rotvec(swing * axis / np.linalg.norm(axis))
                R_BF = (
                    turn * Rotation.from_rotvec(share * roll * home.s_B)
                ).as_matrix() @ home.X_BF[:3, :3]
                p_BF = home.p_BRcm + R_BR @ p - R_BF @ home.p_FTip
                q = _solve(chain, q, R_BF, p_BF, q_home)
            J = _jacobian(chain, q)
            singular = min(singular, float(np.linalg.svd(J, compute_uv=False)[5]))
            margin = min(margin, float(np.minimum(q - low, high - q).min()))
            # Flange twists for unit tip velocities and for unit roll about the shaft.
            L, r = np.linalg.norm(corner), p_BF - home.p_BRcm
            W = np.array([np.cross(s, axis) / L for axis in np.eye(3)])
            V = np.array([(s @ axis) * s for axis in np.eye(3)]) + np.cross(W, r)
            G = np.linalg.pinv(J) @ np.vstack((V.T, W.T))
            g = np.linalg.pinv(J) @ np.concatenate((np.cross(s, r), s))
            rows = np.linalg.norm(G, axis=1)
            speed = max(speed, float(((TIP_SPEED * rows + ROLL_RATE * abs(g)) / v_max).max()))
            a_tip = robot["limits"]["tip_acceleration"]
            acceleration = max(acceleration, float((a_tip * rows / a_max).max()))
            flange = max(flange, TIP_SPEED * float(np.linalg.norm(V.T, 2)))
    tilt = float(np.degrees(np.arccos(-home.s_B[2])))
    return Reach(tilt, margin, singular, speed, acceleration, flange)


def _jacobian(chain: Chain, q: Matrix) -> Matrix:
    """(6, n) by central differences: linear, then angular, of the flange in the base."""
    J, h = np.empty((6, len(q))), 1e-6
    for i in range(len(q)):
        step = np.zeros(len(q))
        step[i] = h
        plus, minus = chain.forward(q + step), chain.forward(q - step)
        J[:3, i] = (plus[:3, 3] - minus[:3, 3]) / (2 * h)
        J[3:, i] = Rotation.from_matrix(plus[:3, :3] @ minus[:3, :3].T).as_rotvec() / (2 * h)
    return J


def _solve(chain: Chain, q: Matrix, R_BF: Matrix, p_BF: Matrix, posture: Matrix) -> Matrix:
    for i in range(25):
        X = chain.forward(q)
        turn = Rotation.from_matrix(R_BF @ X[:3, :3].T).as_rotvec()
        error = np.concatenate((p_BF - X[:3, 3], turn))
        if np.abs(error).max() < 1e-7:
            return q
        J = _jacobian(chain, q)
        inverse = np.linalg.pinv(J)
        step = inverse @ error
        if i < 8:  # pull towards the posture first, then only converge
            step = step + (np.eye(len(q)) - inverse @ J) @ (0.5 * (posture - q))
        q = q + step * min(1.0, 0.3 / float(np.abs(step).max()))
    raise AssertionError(f"no inverse kinematics at {p_BF}: error {error}")
