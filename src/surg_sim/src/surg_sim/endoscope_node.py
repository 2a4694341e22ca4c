"""The node ``/endoscope``: renders the simulator's snapshots in a process of its own."""

from __future__ import annotations

import os
import random
import sys
import threading
import time
from collections import deque

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

import surg_core
from surg_msgs.msg import Ready, SimSnapshot
from surg_sim import scene
from surg_sim.render import Intrinsics, NoOpenGL, Renderer, show_only
from surg_sim.settings import EndoscopeSettings, SettingsError

PARTICIPANT = "endoscope"


def camera_info(intrinsics: Intrinsics) -> CameraInfo:
    """The camera's model as a message without a stamp."""
    f, cx, cy = intrinsics.f, intrinsics.cx, intrinsics.cy
    info = CameraInfo(
        width=intrinsics.width,
        height=intrinsics.height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[f, 0.0, cx, 0.0, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
    info.header.frame_id = scene.ENDOSCOPE
    return info


class Endoscope:
    """Renders in the main thread what the subscriber's thread has put into the queue.

    Args:
        renderer: Of the endoscope camera.
        keep_all: True: every snapshot in order (lock-step); False: the newest only (free-run).
    """

    def __init__(self, renderer: Renderer, keep_all: bool) -> None:
        self._renderer = renderer
        self._info = camera_info(renderer.intrinsics)
        self._waiting: deque[SimSnapshot] = deque(maxlen=None if keep_all else 1)
        self._arrived = threading.Condition()
        self._jitter = float(os.environ.get("SURG_TEST_JITTER_MS", "0")) / 1000 if keep_all else 0.0
        queue = 0 if keep_all else 2
        self._image = rospy.Publisher(
            "/endoscope/left/image_raw", Image, queue_size=queue, tcp_nodelay=True
        )
        self._camera_info = rospy.Publisher(
            "/endoscope/left/camera_info", CameraInfo, queue_size=queue, latch=True
        )
        self._ready = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
        self._camera_info.publish(self._info)
        rospy.Subscriber("/sim/snapshot", SimSnapshot, self._on_snapshot, tcp_nodelay=True)

    def _on_snapshot(self, snapshot: SimSnapshot) -> None:
        with self._arrived:
            self._waiting.append(snapshot)
            self._arrived.notify()

    def run(self) -> None:
        """Render until shutdown."""
        while not rospy.is_shutdown():
            with self._arrived:
                if not self._waiting:
                    self._arrived.wait(0.2)
                    continue
                snapshot = self._waiting.popleft()
            self._show(snapshot)

    def _show(self, snapshot: SimSnapshot) -> None:
        picture = self._renderer.render(np.asarray(snapshot.qpos))
        if self._jitter:
            time.sleep(random.uniform(0.0, self._jitter))
        height, width, _ = picture.shape
        image = Image(
            height=height, width=width, encoding="rgb8", step=3 * width, data=picture.tobytes()
        )
        image.header.frame_id = scene.ENDOSCOPE
        image.header.stamp = self._info.header.stamp = snapshot.header.stamp
        self._image.publish(image)
        self._camera_info.publish(self._info)
        self._ready.publish(Ready(tick=snapshot.tick, participant=PARTICIPANT))


def main() -> int:
    """Entry point; returns the exit code (0 done, 1 no OpenGL, 2 broken configuration)."""
    os.nice(10)  # a picture may come late, a control cycle may not
    rospy.init_node("endoscope")
    try:
        settings = EndoscopeSettings.read(
            lambda name, default: rospy.get_param(f"~{name}", default)
        )
        cell = surg_core.load_cell(settings.cell)
        model = scene.build(scene.choose_arms(cell, settings.arms), settings.seed, looks=True)
        show_only(model, lamps=False)
        renderer = Renderer(
            model,
            scene.ENDOSCOPE,
            settings.width,
            settings.height,
            vignette=settings.vignette,
            hidden=[scene.OUTSIDE],
        )
    except (SettingsError, surg_core.ConfigError, ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2
    except NoOpenGL as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 1
    rospy.loginfo(f"endoscope: {settings.width} x {settings.height} by {renderer.backend}")
    Endoscope(renderer, keep_all=settings.mode == "lockstep").run()
    renderer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
