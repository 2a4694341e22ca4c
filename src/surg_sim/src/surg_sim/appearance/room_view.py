"""The room of a cell, with its arms in given postures: for films of recorded episodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import TracebackType

import numpy as np

import surg_core
from surg_sim import tasks
from surg_sim.appearance.drawing import look
from surg_sim.appearance.render import Renderer, show_only
from surg_sim.arrays import Array, Picture
from surg_sim.physics import scene
from surg_sim.physics.sim_arm import robot_part
from surg_sim.physics.spec_parts import quaternion
from surg_sim.physics.world import World

_LOOK_AT, _NARROW = (-0.30, -0.05, 0.19), 31.0  # [m] patient axes, [deg]


class RoomView:
    """A spectator's view of a cell; a context manager.

    Tissue and free objects of the task stay as they are at the start of its episode.

    Args:
        cell: The cell.
        task: Name or file of the task whose objects lie there; empty: none.
        seed: Of the episode.
        width: Of a picture [px].
        height: Of a picture [px].

    Raises:
        NoOpenGL: Nothing can be drawn here.
        ValueError: The task does not exist or does not fit.
    """

    def __init__(self, cell: surg_core.Cell, task: str, seed: int, width: int, height: int) -> None:
        self._world = World(cell, seed, visuals=True, task=tasks.load(task) if task else None)
        model = self._world.model
        self._joints = {
            name: [
                int(model.joint(robot_part(cell.arms[name], joint)).qposadr[0])
                for joint in cell.arms[name].robot.joint_names
            ]
            for name in self._world.arms
        }
        self._stack = ExitStack()
        self._stack.enter_context(close_up(self._world))
        show_only(model, lamps=True)
        skins = () if self._world.task is None else self._world.task.skins
        self._renderer = Renderer(model, [scene.OVERVIEW], width, height, skins=skins)
        self._stack.callback(self._renderer.close)

    def __enter__(self) -> RoomView:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def picture(self, joints: Mapping[str, Array], assistant: Array | None = None) -> Picture:
        """The room with arms at joint positions (n,) [rad], by name, (height, width, 3), rgb8.

        ``assistant``: yaw, pitch, insertion and roll of the assistant's instrument, if any.
        """
        qpos = self._world.data.qpos
        for name, values in joints.items():
            if name in self._joints:
                qpos[self._joints[name]] = values
        instrument = None if self._world.task is None else self._world.task.assistant
        if instrument is not None and assistant is not None:
            instrument.pose(assistant)
        return self._renderer.render(np.array(qpos))[0]


@contextmanager
def close_up(world: World) -> Iterator[None]:
    """Point the spectator's camera at the patient and narrow its view."""
    model, site = world.model, scene.site_of([world.cell.arms[name] for name in world.arms])
    camera = model.camera(scene.OVERVIEW)
    before = camera.quat.copy(), camera.fovy.copy()
    sight = site.place(_LOOK_AT) - camera.pos
    camera.quat[:] = quaternion(look(sight, np.array([0.0, 0.0, 1.0])))
    camera.fovy[:] = _NARROW
    try:
        yield
    finally:
        camera.quat[:], camera.fovy[:] = before
