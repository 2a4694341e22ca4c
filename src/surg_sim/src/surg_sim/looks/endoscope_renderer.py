"""Renders what the endoscope of a world sees: one camera, or both cameras of a stereo endoscope."""

from __future__ import annotations

from collections.abc import Sequence

from surg_sim.arrays import Array, Picture
from surg_sim.looks.drawing import OUTSIDE
from surg_sim.looks.render import Renderer, show_only
from surg_sim.physics import endoscope_rig
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.endoscope_rig import FRAMES
from surg_sim.physics.world import World


class EndoscopeRenderer:
    """The endoscope of a world that was built with looks; see ``Renderer``.

    The views are ``left`` and ``right`` in this order, or one of them; width and height in px.
    """

    def __init__(
        self, world: World, views: Sequence[str], width: int, height: int, vignette: bool = True
    ) -> None:
        show_only(world.model, lamps=False)
        skins = () if world.task is None else world.task.skins
        self.views = tuple(views)
        cameras = [FRAMES[view] for view in views]
        self._renderer = Renderer(world.model, cameras, width, height, vignette, [OUTSIDE], skins)
        self.intrinsics, self.backend = self._renderer.intrinsics, self._renderer.backend
        self.baseline = self._renderer.baseline
        """Distance of the right camera from the left one [m]; 0 with one view."""
        held = endoscope_rig.holder([world.cell.arms[name] for name in world.arms])
        self.standing_pose = None if held else EndoscopeView(world.model, world.data).pose
        """X_WV (4, 4) of an endoscope that no arm holds; None: an arm holds it."""
        self.close = self._renderer.close

    def render(self, qpos: Array) -> dict[str, Picture]:
        """Picture of each view at joint positions qpos, (height, width, 3), rgb8."""
        return dict(zip(self.views, self._renderer.render(qpos), strict=True))
