"""Where the endoscope sees a point: geometry only, no rendering."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_core.transforms import make_pose
from surg_sim.arrays import Array
from surg_sim.physics.endoscope_rig import LEFT

CIRCLE = 0.56
"""Radius of the endoscope's round picture, as a share of its height."""


class EndoscopeView:
    """A camera of the endoscope in a compiled scene as a pinhole; by default the left one."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, camera: str = LEFT) -> None:
        self._data = data
        camera_id = int(model.camera(camera).id)
        self._mount = int(model.cam_bodyid[camera_id])
        self._place = np.array(model.cam_pos[camera_id])
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, model.cam_quat[camera_id])
        self._turn = R.reshape(3, 3)
        self.f = 0.5 / np.tan(np.radians(float(model.cam_fovy[camera_id])) / 2.0)
        """Focal length in picture heights."""

    @property
    def pose(self) -> Array:
        """Pose of the optical frame (x right, y down, z away) in the world, (4, 4)."""
        R = self._data.xmat[self._mount].reshape(3, 3)
        p = self._data.xpos[self._mount] + R @ self._place
        return make_pose(p, R @ self._turn @ np.diag([1.0, -1.0, -1.0]))

    def project(self, points: Array) -> Array:
        """Places of points (n, 3) [m] of the world, in picture heights from the picture's centre.

        (n, 2), x right, y down; not a number for what is not in front of the lens.
        """
        X = self.pose
        p = (np.atleast_2d(points) - X[:3, 3]) @ X[:3, :3]
        depth = np.where(p[:, 2] > 1e-3, p[:, 2], np.nan)
        return np.asarray(self.f * p[:, :2] / depth[:, None])

    def sees(self, points: Array) -> bool:
        """Whether all points of the world, (n, 3) [m], are in the round picture of 4 : 3."""
        margin = 0.03  # [picture heights] at the edge, which does not count
        uv = self.project(points)
        inside = np.hypot(uv[:, 0], uv[:, 1]) < CIRCLE - margin
        inside &= np.abs(uv[:, 0]) < 2.0 / 3.0 - margin
        inside &= np.abs(uv[:, 1]) < 0.5 - margin
        return bool(inside.all())
