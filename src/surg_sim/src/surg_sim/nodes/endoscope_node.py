"""The node ``/endoscope``: renders the simulator's snapshots in a process of its own."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Mapping

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

import surg_core
from surg_core.lens_file import Lens, load_lens
from surg_msgs.msg import Ready, SimSnapshot
from surg_ros.endoscope_tf import EndoscopeTf
from surg_ros.params import read
from surg_sim import tasks
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.arrays import Picture
from surg_sim.nodes.exposure_schedule import RENDERER
from surg_sim.nodes.sim_parameters import EndoscopeSettings
from surg_sim.physics import patient_settings
from surg_sim.physics.endoscope_rig import FRAMES
from surg_sim.physics.world import World


def measured_lens(cell: surg_core.Cell, view: str, size: tuple[int, int]) -> Lens | None:
    """The lens of a view as the cell has measured it, for a size [px]; None: it has not.

    Raises:
        ConfigError: The lens file is invalid, or of another aspect.
    """
    file = cell.folder / "calibration" / f"{FRAMES[view]}.yaml"
    return load_lens(file).resized(*size) if file.is_file() else None


class CameraTopics:
    """The topics of the camera ``left`` or ``right``; queue 0 of its publishers: without end."""

    def __init__(self, name: str, info: CameraInfo, queue: int) -> None:
        self._info = info
        root = f"/endoscope/{name}"
        self._image = rospy.Publisher(
            f"{root}/image_raw", Image, queue_size=queue, tcp_nodelay=True
        )
        self._camera_info = rospy.Publisher(
            f"{root}/camera_info", CameraInfo, queue_size=queue, latch=True
        )
        self._camera_info.publish(info)

    def publish(self, picture: Picture, stamp: rospy.Time) -> None:
        """Publish a picture with its camera's model, both of this stamp."""
        height, width, _ = picture.shape
        image = Image(
            height=height, width=width, encoding="rgb8", step=3 * width, data=picture.tobytes()
        )
        image.header.frame_id = self._info.header.frame_id
        image.header.stamp = self._info.header.stamp = stamp
        self._image.publish(image)
        self._camera_info.publish(self._info)


class Endoscope:
    """Renders in the main thread what the subscriber's thread has put into the queue.

    ``keep_all``: every snapshot in order (lock-step); else the newest only (free-run).
    """

    def __init__(
        self,
        world: World,
        seed: int,
        renderer: EndoscopeRenderer,
        keep_all: bool,
        lenses: Mapping[str, Lens | None],
    ) -> None:
        self._world, self._seed = world, seed
        self._renderer, self._keep_all = renderer, keep_all
        self._waiting: deque[SimSnapshot] = deque(maxlen=None if keep_all else 1)
        self._arrived = threading.Condition()
        self._cameras = {}
        for view in renderer.views:
            # What is believed, not what is rendered.
            info = CameraInfo(**(lenses[view] or renderer.lens(view)).camera_info)
            info.header.frame_id = FRAMES[view]
            self._cameras[view] = CameraTopics(view, info, 0 if keep_all else 2)
        self._ready = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
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
            self._render(snapshot)

    def _render(self, snapshot: SimSnapshot) -> None:
        if self._world.task is not None and snapshot.seed != self._seed:
            self._seed = snapshot.seed  # what a task has moved in the model itself
            self._world.reset(self._seed)
        pictures = self._renderer.render(np.asarray(snapshot.qpos))
        rendered = Ready(tick=snapshot.tick, participant=RENDERER)
        if not self._keep_all:  # the next exposure is made while this picture is sent
            self._ready.publish(rendered)
        for view, picture in pictures.items():
            self._cameras[view].publish(picture, snapshot.header.stamp)
        if self._keep_all:
            self._ready.publish(rendered)


def main() -> int:
    """Entry point; returns the exit code (0 done, 1 no OpenGL, 2 broken configuration)."""
    rospy.init_node("endoscope")
    try:
        settings = read(EndoscopeSettings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell)
        size = (settings.width, settings.height)
        lenses = {view: measured_lens(cell, view, size) for view in settings.views}
        world = World(
            cell,
            settings.seed,
            visuals=True,
            arms=settings.arms,
            setting=patient_settings.find_setting(settings.setting) if settings.setting else None,
            task=tasks.load(settings.task) if settings.task else None,
        )
        renderer = EndoscopeRenderer(world, settings.views, *size, settings.vignette)
    except (ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2
    except NoOpenGL as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 1
    rospy.loginfo(f"endoscope: {settings.width} x {settings.height} by {renderer.backend}")
    frames = EndoscopeTf(cell, renderer.standing_pose)
    Endoscope(world, settings.seed, renderer, settings.mode == "lockstep", lenses).run()
    del frames
    renderer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
