"""Renders what the endoscope of a world sees: one camera, or both cameras of a stereo endoscope."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_core.lens_file import Lens
from surg_sim.appearance.domain_randomization import Appearance
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.lens import LensRemap, TrueEye
from surg_sim.appearance.render import Intrinsics, Renderer, Vignette, show_only
from surg_sim.appearance.scene_appearance import Finish, dressed
from surg_sim.arrays import Array, Picture
from surg_sim.physics import endoscope_rig
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.endoscope_rig import FRAMES
from surg_sim.physics.world import World


class EndoscopeRenderer:
    """The endoscope of a world that was built with visuals; see ``Renderer``.

    The views are ``left`` and ``right`` in this order, or one of them; width and height in px.
    """

    def __init__(
        self, world: World, views: Sequence[str], width: int, height: int, vignette: bool = True
    ) -> None:
        show_only(world.model, lamps=False)
        skins = () if world.task is None else world.task.skins
        self.views = tuple(views)
        cameras = [FRAMES[view] for view in views]
        fovy = float(world.model.camera(cameras[0]).fovy[0])
        self.intrinsics = Intrinsics.from_fovy(width, height, fovy)
        """The pinhole that the instrument's file states, whatever lens there really is."""
        self._remap, self._edge = None, None
        size, cut = (width, height), vignette
        lens = world.endoscope_lens
        if not lens.perfect:
            self._remap = LensRemap(TrueEye(lens, self.intrinsics.f, width, height))
            size, cut = self._remap.wide_size, False
            self._edge = Vignette(width, height) if vignette else None
            for camera in cameras:
                angle = 2.0 * np.degrees(np.arctan(size[1] / 2 / self.intrinsics.f))
                world.model.camera(camera).fovy[0] = angle
        self._renderer = Renderer(world.model, cameras, *size, cut, [OUTSIDE], skins)
        self.backend = self._renderer.backend
        self.baseline = self._renderer.baseline
        """Distance of the right camera from the left one [m]; 0 with one view."""
        held = endoscope_rig.holder([world.cell.arms[name] for name in world.arms])
        self.standing_pose = None if held else EndoscopeView(world.model, world.data).pose
        """X_WV (4, 4) of an endoscope that no arm holds; None: an arm holds it."""
        self.close = self._renderer.close
        self._plain, self._dyed = world.model, list[int]()
        self._finish: Finish | None = None

    def set_appearance(self, look: Appearance | None) -> None:
        """Draw pictures with this look from now on; None: as the scene was built.

        The look's camera is the true one. ``intrinsics``, ``baseline`` and ``standing_pose`` stay
        what a robot would believe.
        """
        worn, dyed = (self._plain, list[int]()) if look is None else dressed(self._plain, look)
        self._renderer.show(worn, {*self._dyed, *dyed})
        self._dyed = dyed
        size = self.intrinsics.width, self.intrinsics.height
        self._finish = None if look is None else Finish(look, *size)

    def lens(self, view: str) -> Lens:
        """The pinhole of a view, as its lens file would state it."""
        return self.intrinsics.lens(FRAMES[view], self.baseline if view == "right" else 0.0)

    def render(self, qpos: Array) -> dict[str, Picture]:
        """Picture of each view at joint positions qpos, (height, width, 3), rgb8."""
        pictures = self._renderer.render(qpos)
        if self._remap is not None:
            pictures = [self._real(self._remap.apply(picture)) for picture in pictures]
        if self._finish is not None:
            pictures = [self._finish(picture) for picture in pictures]
        return dict(zip(self.views, pictures, strict=True))

    def _real(self, picture: Picture) -> Picture:
        """A picture through the lens with the endoscope's round edge."""
        if self._edge is None:
            return picture
        left = self._edge.left
        whole = np.zeros_like(picture)
        self._edge.cut(
            picture[:, left : picture.shape[1] - left],
            out=whole[:, left : picture.shape[1] - left],
        )
        return whole
