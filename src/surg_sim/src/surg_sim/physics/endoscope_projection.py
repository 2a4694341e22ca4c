"""Where the endoscope sees a point: geometry only, no rendering."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.physics import scene

Array = NDArray[np.float64]

CIRCLE = 0.56
"""Radius of the endoscope's round picture, as a share of its height."""


class EndoscopeView:
    """A camera of the endoscope in a compiled scene as a pinhole.

    Args:
        model: The compiled scene.
        data: Its state; kinematics up to date.
        camera: Its name; the left one.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera: str = scene.ENDOSCOPE
    ) -> None:
        self._data = data
        self._camera = int(model.camera(camera).id)
        self._mount = int(model.cam_bodyid[self._camera])
        self._place = np.array(model.cam_pos[self._camera])
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, model.cam_quat[self._camera])
        self._turn = R.reshape(3, 3)
        self.f = 0.5 / np.tan(np.radians(float(model.cam_fovy[self._camera])) / 2.0)
        """Focal length in picture heights."""

    @property
    def pose(self) -> Array:
        """Pose of the optical frame (x right, y down, z away) in the world, (4, 4)."""
        R = self._data.xmat[self._mount].reshape(3, 3)
        X = np.eye(4)
        X[:3, :3] = R @ self._turn @ np.diag([1.0, -1.0, -1.0])
        X[:3, 3] = self._data.xpos[self._mount] + R @ self._place
        return X

    def project(self, points: Array) -> Array:
        """Places in the picture in picture heights from its centre, x right, y down, (n, 2).

        Not a number for what is not in front of the lens.

        Args:
            points: In the world, (n, 3) [m].
        """
        X = self.pose
        p = (np.atleast_2d(points) - X[:3, 3]) @ X[:3, :3]
        depth = np.where(p[:, 2] > 1e-3, p[:, 2], np.nan)
        return np.asarray(self.f * p[:, :2] / depth[:, None])

    def sees(self, points: Array, width: float = 4.0 / 3.0, margin: float = 0.03) -> bool:
        """Whether all points are in the round picture.

        Args:
            points: In the world, (n, 3) [m].
            width: Of the picture, in picture heights.
            margin: Width of a border that does not count, in picture heights.
        """
        uv = self.project(points)
        inside = np.hypot(uv[:, 0], uv[:, 1]) < CIRCLE - margin
        inside &= np.abs(uv[:, 0]) < width / 2.0 - margin
        inside &= np.abs(uv[:, 1]) < 0.5 - margin
        return bool(inside.all())
