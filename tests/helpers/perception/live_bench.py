"""A board before the endoscope of a running simulator, and the person who holds it.

The joints are the running system's. The bench draws what the true lenses see of the board from the
true eye and publishes it as the endoscope would. The graph runs in lock-step: nothing depends on
the machine's speed.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image, JointState

import surg_core
from helpers.graph.crtk_client import TICK, Arm, LockstepTime, shifted
from helpers.sim.board_bench import BenchView, BoardBench
from surg_msgs.msg import CalibrationStatus, GroundTruth
from surg_sim.arrays import Array, Picture

ARMS = ("PSM1", "ECM")
LOOKS, BETWEEN = 6, 50
"""Pictures of a view that is held, and the ticks from one to the next."""
BEFORE = 10
"""Ticks by which a picture is older than the newest joints."""
PATIENCE_S = 240.0


class LiveBench:
    """Publishes pictures of the board and commands the arms.

    Args:
        bench: What is true.
        node: Name of this process in the graph.
    """

    def __init__(self, bench: BoardBench, node: str) -> None:
        self.bench = bench
        self.clock = LockstepTime(node, *ARMS)
        self.arms = {name: Arm(name, self.clock) for name in ARMS}
        self.joints: dict[str, Array] = {}
        self.true_tip = np.zeros(3)
        self.status: CalibrationStatus | None = None
        self.statuses, self._heard = 0, threading.Condition()
        keys: dict[str, Any] = {"queue_size": 1, "tcp_nodelay": True}
        self._images = [
            rospy.Publisher(f"/endoscope/{eye}/image_raw", Image, **keys)
            for eye in ("left", "right")
        ]
        self._info = rospy.Publisher("/endoscope/left/camera_info", CameraInfo, latch=True, **keys)
        self._info.publish(self._pinhole())
        self._ears = [
            rospy.Subscriber(f"/{arm}/robot/measured_js", JointState, self._on_joints, arm, **keys)
            for arm in ARMS
        ]
        self._ears += [
            rospy.Subscriber("/calibrate/status", CalibrationStatus, self._on_status, **keys),
            rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._on_truth, **keys),
        ]

    def _pinhole(self) -> CameraInfo:
        """What the instrument's drawing states; nobody has measured the lens."""
        camera = self.bench.scope.arm.instrument.camera
        assert camera is not None
        width, height = self.bench.size
        f = 0.5 * height / np.tan(float(camera.fovy) / 2.0)
        K = [f, 0.0, (width - 1) / 2, 0.0, f, (height - 1) / 2, 0.0, 0.0, 1.0]
        return CameraInfo(width=width, height=height, K=K)

    def _on_joints(self, message: JointState, arm: str) -> None:
        where = dict(zip(message.name, message.position, strict=True))
        self.joints[arm] = np.array(
            [where[name] for name in self.bench.cell.arms[arm].robot.joint_names]
        )

    def _on_status(self, message: CalibrationStatus) -> None:
        with self._heard:
            self.status = message
            self.statuses += 1
            self._heard.notify_all()

    def _on_truth(self, message: GroundTruth) -> None:
        for arm in message.arms:
            if arm.arm == "PSM1":
                self.true_tip = np.array([arm.tip.x, arm.tip.y, arm.tip.z])

    def connected(self) -> bool:
        """Whether simulator and controllers are there."""
        return self.clock.connected() and not any(
            group.unconnected() for arm in self.arms.values() for group in arm.groups
        )

    def seen(self) -> bool:
        """Whether a collector listens to both eyes and speaks."""
        return self.watched() and self._ears[2].get_num_connections() > 0

    def watched(self) -> bool:
        """Whether somebody listens to both eyes."""
        return min(image.get_num_connections() for image in self._images) > 0

    def enable(self) -> None:
        """Both arms."""
        for arm in self.arms.values():
            assert arm.enable(5.0) and arm.home(5.0), arm.state

    def X_VBoard(self, X_BBoard: Array) -> Array:
        """The board (4, 4) before the true left eye; it lies at X_BBoard in the scope's base."""
        X_BF = self.bench.scope.arm.chain.forward(self.joints["ECM"])
        return np.asarray(surg_core.inverse_pose(X_BF @ self.bench.X_FV) @ X_BBoard)

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.arms["PSM1"].sleep(seconds)

    def hold(self, view: BenchView, collector: subprocess.Popen[bytes]) -> None:
        """Show a view until the collector has looked at it, or has ended."""
        pair = self.bench.pictures(view)
        for _ in range(LOOKS):
            self.publish(pair)
            self._looked(collector)
            self.sleep(BETWEEN * TICK)

    def publish(self, pair: tuple[Picture, Picture]) -> None:
        """Both pictures with one stamp."""
        for publisher, picture, eye in zip(self._images, pair, ("left", "right"), strict=True):
            height, width = picture.shape
            message = Image(
                height=height, width=width, step=width, encoding="mono8", data=picture.tobytes()
            )
            message.header.frame_id = f"endoscope_{eye}"
            message.header.stamp = rospy.Time.from_sec(max(1, self.clock.tick - BEFORE) * TICK)
            publisher.publish(message)

    def _looked(self, collector: subprocess.Popen[bytes]) -> None:
        """Wait for two reports: the second was made after the pictures were looked at."""
        wanted, end = self.statuses + 2, time.monotonic() + PATIENCE_S
        with self._heard:
            while self.statuses < wanted and collector.poll() is None:
                assert time.monotonic() < end, "the collector says nothing"
                self._heard.wait(0.1)

    def go(self, arm: str, joints: Array) -> None:
        """Move by yaw, pitch, insertion and roll, and come to rest."""
        self.arms[arm].move_jp(joints).wait(timeout=8.0)
        self.sleep(0.6)

    def touch(self, place: Array) -> None:
        """Bring the true tip of PSM1 to a place (3,) of its base, as an eye guides a hand."""
        arm, tool = self.arms["PSM1"], self.bench.tool
        R_BRcm = surg_core.rcm_frame(tool.s_home, tool.arm.trocar.p_BRcm)[:3, :3]
        for _ in range(3):
            away = R_BRcm.T @ (place - self.true_tip)
            arm.move_cp(shifted(arm.setpoint_cp(), away)).wait(timeout=6.0)
            self.sleep(0.1)
        self.sleep(0.5)
        missed = float(np.linalg.norm(place - self.true_tip))
        assert missed < 1e-3, f"{1e3 * missed:.2f} mm from the corner"

    def show(self, view: BenchView, until: Callable[[], bool]) -> None:
        """Show a view, picture after picture, until somebody has looked at it."""
        pair, end = self.bench.pictures(view), time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < end, "nobody looks"
            self.publish(pair)
            looked = time.monotonic() + 0.5
            while time.monotonic() < looked and not until():
                time.sleep(0.01)
            self.sleep(TICK)

    def close(self) -> None:
        """Leave the graph."""
        for arm in self.arms.values():
            arm.close()
        self.clock.close()
        for topic in (*self._images, self._info, *self._ears):
            topic.unregister()
