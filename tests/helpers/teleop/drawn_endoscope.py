"""A stereo endoscope that draws: a stick in front of speckles, where the tip really is.

For tests of who looks at pictures: as quick as the arm moves, no OpenGL. What it shows comes from
the controllers' cycles; what looks at it knows nothing of that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rospy
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

import surg_core
from surg_msgs.msg import Cycle
from surg_sim.physics.endoscope_rig import camera_poses

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

WIDTH, HEIGHT, F, BASELINE = 320, 240, 225.0, 0.004
EVERY = 25
STICK = np.array([0.6, -0.8])
"""Where the stick goes from its tip in the picture: out of it, up and to the right."""


class DrawnEndoscope:
    """Publishes a pair for every 25th cycle of the instrument.

    Args:
        cell: With PSM1 and ECM.
        wiring: What is done to a pair on its way.
    """

    def __init__(
        self,
        cell: surg_core.Cell,
        wiring: Callable[[Picture, Picture], tuple[Picture, Picture]],
    ) -> None:
        tool, scope = cell.arms["PSM1"], cell.arms["ECM"]
        self._X_WB, self._wiring = np.asarray(tool.X_WB), wiring
        X_WF = np.asarray(scope.X_WB) @ np.asarray(scope.chain.forward(scope.robot.home))
        self._X_VW = np.linalg.inv(X_WF @ camera_poses(scope)[0])
        rng = np.random.default_rng(4)
        self._tissue = rng.integers(60, 140, (HEIGHT, WIDTH, 3)).astype(np.uint8)
        self._metal = rng.integers(150, 255, (40, 14, 3)).astype(np.uint8)
        self._x, self._y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        keys: dict[str, Any] = {"queue_size": 0, "tcp_nodelay": True}
        self._out = [
            (
                rospy.Publisher(f"/endoscope/{eye}/image_raw", Image, **keys),
                rospy.Publisher(f"/endoscope/{eye}/camera_info", CameraInfo, latch=True, **keys),
                shift,
            )
            for eye, shift in (("left", 0.0), ("right", BASELINE))
        ]
        self.topics: list[Any] = [p for image, info, _ in self._out for p in (image, info)]
        for _, info, shift in self._out:
            info.publish(self._info(shift))
        self.topics.append(rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, tcp_nodelay=True))

    def _info(self, shift: float) -> CameraInfo:
        cx, cy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
        K = [F, 0.0, cx, 0.0, F, cy, 0.0, 0.0, 1.0]
        P = [F, 0.0, cx, -F * shift, 0.0, F, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        return CameraInfo(width=WIDTH, height=HEIGHT, K=K, P=P)

    def _on_cycle(self, cycle: Cycle) -> None:
        if cycle.tick % EVERY:
            return
        p = self._X_WB[:3, :3] @ np.array(cycle.p_tip) + self._X_WB[:3, 3]
        p_V = self._X_VW[:3, :3] @ p + self._X_VW[:3, 3]
        pair = self._wiring(*(self.draw(p_V, shift) for _, _, shift in self._out))
        for (image, _, _), picture in zip(self._out, pair, strict=True):
            message = Image(
                height=HEIGHT, width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=picture.tobytes()
            )
            message.header.stamp = cycle.header.stamp
            image.publish(message)

    def draw(self, p_V: Array, shift: float) -> Picture:
        """The picture of an eye that stands ``shift`` to the right of the left one."""
        scale = F / p_V[2]
        x = self._x - (WIDTH - 1) / 2 - scale * (p_V[0] - shift)
        y = self._y - (HEIGHT - 1) / 2 - scale * p_V[1]
        along = (x * STICK[0] + y * STICK[1]) / scale  # in the picture's plane at the tip [m]
        across = (y * STICK[0] - x * STICK[1]) / scale
        stick = (along >= 0.0) & (np.abs(across) < 0.004)
        picture = self._tissue.copy()
        u = np.minimum((along[stick] / 0.002).astype(int), 39)
        v = ((across[stick] + 0.004) / 0.008 * 13.99).astype(int)
        picture[stick] = self._metal[u, v]
        return picture

    def close(self) -> None:
        """Leave the graph."""
        for topic in self.topics:
            topic.unregister()
