"""Renders what the endoscope of a world sees: one camera, or both cameras of a stereo endoscope."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surg_sim.looks.drawing import OUTSIDE
from surg_sim.looks.render import Picture, Renderer, StereoRenderer, show_only
from surg_sim.physics.endoscope_rig import FRAMES

if TYPE_CHECKING:
    from surg_sim.physics.world import World


class EndoscopeRenderer:
    """Use it from the thread that made it.

    Args:
        world: Built with ``looks=True``.
        views: ``left`` and ``right`` in this order, or one of them.
        width: Of each picture [px].
        height: Of each picture [px].
        vignette: Draw the round edge of an endoscope's picture.

    Raises:
        NoOpenGL: No OpenGL platform works.
        ValueError: The scene has no second camera, or the picture is too large.
    """

    def __init__(
        self, world: World, views: Sequence[str], width: int, height: int, vignette: bool = True
    ) -> None:
        show_only(world.model, lamps=False)
        skins = () if world.task is None else world.task.skins
        self.views = tuple(views)
        size = (width, height, vignette, [OUTSIDE], skins)
        self._renderer: Renderer
        if len(self.views) == 2:
            self._renderer = StereoRenderer(world.model, *size)
        else:
            self._renderer = Renderer(world.model, FRAMES[self.views[0]], *size)
        self.intrinsics = self._renderer.intrinsics
        self.backend = self._renderer.backend

    @property
    def baseline(self) -> float:
        """Distance of the right camera from the left one [m]; 0 with one view."""
        return getattr(self._renderer, "baseline", 0.0)

    def render(self, qpos: NDArray[np.float64]) -> dict[str, Picture]:
        """Picture of each view at joint positions qpos, (height, width, 3), rgb8."""
        if isinstance(self._renderer, StereoRenderer):
            return dict(zip(self.views, self._renderer.pair(qpos), strict=True))
        return {self.views[0]: self._renderer.render(qpos)}

    def close(self) -> None:
        """Release the OpenGL context."""
        self._renderer.close()
