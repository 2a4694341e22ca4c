"""The six joints behind a wrist and the tip that they hold.

Joints are one array (6,): wrist centre x, y, z in the rcm frame [m], roll, pitch and yaw [rad]. The
arm's limits hold for these numbers, so whoever interpolates, clips or judges a target does it here.
"""

from __future__ import annotations

import math

import numpy as np

from surg_core._core import WristGeometry, minimal_rotation, tip_of_wrist, wrists_of_tip
from surg_core.transforms import (
    FloatArray,
    make_pose,
    rotate,
    tip_quaternion,
    twist_angle,
)


def tip_of_joints(wrist: WristGeometry, joints: FloatArray) -> FloatArray:
    """Pose (4, 4) of the tool frame in the rcm frame; a target's jaw may follow the joints."""
    X_RCentre = make_pose(joints[:3], tip_quaternion(joints[:3], float(joints[3])))
    return np.array(tip_of_wrist(wrist, X_RCentre, joints[4:6]))


def joints_of_tip(wrist: WristGeometry, X_RTip: FloatArray, near_roll: float) -> FloatArray | None:
    """The joints (6,) of a tip, of equal rolls the one nearest to ``near_roll`` [rad].

    None: the yaw axis points to the trocar, and the roll is free.
    """
    found = wrists_of_tip(wrist, X_RTip)
    if not found:
        return None
    X_RCentre, turns = found[0]
    centre = X_RCentre[:3, 3]
    swing = minimal_rotation([0.0, 0.0, 1.0], centre / np.linalg.norm(centre))
    roll = float(twist_angle(swing.T @ X_RCentre[:3, :3])[0])
    return np.array([*centre, near_roll + math.remainder(roll - near_roll, math.tau), *turns])


def wrist_centres(
    wrist: WristGeometry, p_RTip: FloatArray, q_RTip: FloatArray, yaw: FloatArray
) -> FloatArray:
    """Wrist centres (N, 3) of tips (N, 3) with orientations x, y, z, w (N, 4) and yaws (N,)."""
    across, along = np.sin(yaw), np.cos(yaw)
    link = [-np.sin(wrist.turn) * across, np.cos(wrist.turn) * across, along]
    lever = wrist.pitch_to_yaw * np.stack(link, axis=-1)
    lever[:, 2] += wrist.yaw_to_tip
    return np.asarray(p_RTip - rotate(q_RTip, lever))
