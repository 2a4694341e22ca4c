"""Where the assistant's instrument is for its virtual joints, and the other way round."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surg_core.transforms import make_pose, minimal_rotation, virtual_joints
from surg_sim.physics.assistant_arm import Assistant

Array = NDArray[np.float64]


def forward(joints: Array) -> Array:
    """Pose of the tip in the trocar frame for virtual joints (4,), as (4, 4)."""
    yaw, pitch, insertion, roll = (float(v) for v in joints)
    s = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    c, s_roll = np.cos(roll), np.sin(roll)
    swing = minimal_rotation([0.0, 0.0, 1.0], s)
    R = swing @ np.array([[c, -s_roll, 0], [s_roll, c, 0], [0, 0, 1]])
    return make_pose(insertion * R[:, 2], R)


def joints_for(assistant: Assistant, p_WTip: Array, roll: float = 0.0) -> Array:
    """Virtual joints that bring the tip to a point in the world [m], with this roll."""
    X = assistant.X_WRcm
    return virtual_joints(X[:3, :3].T @ (np.asarray(p_WTip) - X[:3, 3]), roll)
