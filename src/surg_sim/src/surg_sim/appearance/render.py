"""Off-screen pictures of a scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from surg_core.lens_file import Lens
from surg_core.transforms import make_pose
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.opengl import choose_backend, context
from surg_sim.arrays import Array, Picture
from surg_sim.physics.endoscope_projection import CIRCLE

LAMPS = ("lamp", "fill")
"""Lights of the room; the endoscope does not see them."""


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole model of a rendered picture; pixel centres have integer coordinates."""

    width: int  # [px]
    height: int  # [px]
    f: float  # focal length, the same in x and y [px]
    cx: float  # principal point [px]
    cy: float  # principal point [px]

    @classmethod
    def from_fovy(cls, width: int, height: int, fovy: float) -> Intrinsics:
        """From the vertical field of view [deg]: f = (height / 2) / tan(fovy / 2)."""
        f = height / 2 / np.tan(np.radians(fovy) / 2)
        return cls(width, height, float(f), (width - 1) / 2, (height - 1) / 2)

    @property
    def K(self) -> Array:
        """Camera matrix, (3, 3)."""
        return np.array([[self.f, 0, self.cx], [0, self.f, self.cy], [0, 0, 1]])

    def lens(self, name: str, baseline: float = 0.0) -> Lens:
        """The lens of a camera this far [m] to the right of the left one.

        A point in the left optical frame gives the picture of this camera: P[0, 3] = -f baseline.
        """
        P = np.hstack([self.K, np.zeros((3, 1))])
        P[0, 3] = -self.f * baseline
        return Lens(self.width, self.height, name, self.K, "plumb_bob", np.zeros(5), np.eye(3), P)

    def project(self, point: Array) -> Array:
        """Pixel (x, y) of a point in the optical frame (x right, y down, z away) [m], (2,)."""
        return np.asarray((self.K @ point)[:2] / point[2])


class Skin(Protocol):
    """What changes its shape from picture to picture."""

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
        """Write the shape at the state in ``data`` into the scene's skins."""


class Renderer:
    """Renders cameras of a compiled scene. Use it from the thread that made it.

    Args:
        model: A scene built with ``visuals=True``.
        cameras: Names, with the same field of view.
        width: [px].
        height: [px].
        vignette: Draw the round edge of an endoscope's picture.
        hidden: Groups of geoms to leave out.
        skins: Drawn after everything else has its place.

    Raises:
        NoOpenGL: No platform works.
        ValueError: A camera is not in the scene, or the picture does not fit its buffer.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        cameras: Sequence[str],
        width: int,
        height: int,
        vignette: bool = False,
        hidden: Iterable[int] = (),
        skins: Sequence[Skin] = (),
    ) -> None:
        limit = model.vis.global_
        if width > limit.offwidth or height > limit.offheight or min(width, height) < 16:
            raise ValueError(
                f"picture {width} x {height}: allowed are 16 x 16 to "
                f"{limit.offwidth} x {limit.offheight}"
            )
        self._model, self._data = model, mujoco.MjData(model)
        self._skins = tuple(skins)
        self._round = Vignette(width, height) if vignette else None
        self._shape = (height, width, 3)
        # What the vignette hides at both sides is not drawn: a sixth of a picture of 4 : 3.
        self._left = 0 if self._round is None else self._round.left
        seen = width - 2 * self._left
        self.backend = choose_backend()
        self._gl, self._mjr = context(self.backend, model, seen, height)
        self._closed = False
        self._sharpen()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        self._scene = mujoco.MjvScene(model, maxgeom=2000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._option = mujoco.MjvOption()
        for group in hidden:
            self._option.geomgroup[group] = 0
            if group == OUTSIDE:  # nor its sky: 7 % of the work, for nothing that is seen
                self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        self._cameras = [_fixed(model, name) for name in cameras]
        self._rect = mujoco.MjrRect(0, 0, seen, height)
        self._upside_down = np.empty((height, seen, 3), dtype=np.uint8)
        self.intrinsics = Intrinsics.from_fovy(
            width, height, float(model.cam_fovy[self._cameras[0].fixedcamid])
        )
        mujoco.mj_forward(model, self._data)
        first, last = (self._data.cam_xpos[self._cameras[i].fixedcamid] for i in (0, -1))
        self.baseline = float(np.linalg.norm(last - first))
        """Distance between the cameras [m]; 0 with one."""

    def _sharpen(self) -> None:
        """Sample one mipmap level instead of two: a third less work without a GPU."""
        from OpenGL import GL

        for texture, kind in zip(self._mjr.texture, self._model.tex_type, strict=False):
            if kind == mujoco.mjtTexture.mjTEXTURE_2D:
                GL.glBindTexture(GL.GL_TEXTURE_2D, int(texture))
                GL.glTexParameteri(
                    GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_NEAREST
                )

    def show(self, model: mujoco.MjModel, textures: Iterable[int] = ()) -> None:
        """Draw this model from now on: a copy of the first one that looks otherwise.

        Numbers of the textures that differ from those shown before.
        """
        self._gl.make_current()  # another renderer of this thread may have been made since
        self._model, self._data = model, mujoco.MjData(model)
        for texture in textures:
            mujoco.mjr_uploadTexture(model, self._mjr, texture)
        self._sharpen()

    def render(self, qpos: Array) -> list[Picture]:
        """A new picture of each camera at joint positions qpos, (height, width, 3), rgb8.

        The scene is set up once, skins included.

        Raises:
            ValueError: qpos has the wrong length: the snapshot is of another scene.
        """
        self._arrange(qpos)
        pictures = [self._shoot()]
        for camera in self._cameras[1:]:
            mujoco.mjv_updateCamera(self._model, self._data, camera, self._scene)
            pictures.append(self._shoot())
        return pictures

    def _arrange(self, qpos: Array) -> None:
        """Put everything in its place, once for all cameras."""
        if len(qpos) != self._model.nq:
            raise ValueError(f"qpos has {len(qpos)} values, this scene has {self._model.nq}")
        self._gl.make_current()
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._option,
            None,
            self._cameras[0],
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )
        for skin in self._skins:
            skin.draw(self._scene, self._data)

    def _shoot(self) -> Picture:
        """The picture of the camera that the scene is set to."""
        mujoco.mjr_render(self._rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(self._upside_down, None, self._rect, self._mjr)
        if self._round is None:
            return np.ascontiguousarray(self._upside_down[::-1])
        picture = np.zeros(self._shape, dtype=np.uint8)
        middle = picture[:, self._left : self._shape[1] - self._left]
        self._round.cut(self._upside_down[::-1], out=middle)
        return picture

    def camera_pose(self) -> Array:
        """Pose of the first optical frame (x right, y down, z away) in the world, (4, 4)."""
        camera = self._cameras[0].fixedcamid
        R = self._data.cam_xmat[camera].reshape(3, 3)
        return make_pose(self._data.cam_xpos[camera], R @ np.diag([1.0, -1.0, -1.0]))

    def close(self) -> None:
        """Give the context back; once is enough."""
        if self._closed:
            return
        self._closed = True
        self._gl.make_current()  # what is freed is deleted in the current one
        self._mjr.free()
        self._gl.free()


def _fixed(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name) < 0:
        raise ValueError(
            f"this scene has no camera '{name}'; a pair needs a cell with an arm that holds a "
            "stereo endoscope, such as cells/sim_two_arms"
        )
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(name).id
    return camera


def show_only(model: mujoco.MjModel, lamps: bool) -> None:
    """Light the room (True) or leave only the endoscope's own light (False)."""
    for name in LAMPS:
        model.light_active[model.light(name).id] = lamps


class Vignette:
    """The round edge of an endoscope's picture: black outside, soft over three pixels.

    ``left`` columns at either side are all black.
    """

    def __init__(self, width: int, height: int) -> None:
        radius = CIRCLE * height
        self.left = max(0, int(width / 2 - radius))
        x = np.arange(self.left, width - self.left) - (width - 1) / 2
        y = np.arange(height) - (height - 1) / 2
        inside = radius - np.hypot(x[None, :], y[:, None])
        # As wide as the picture's own rows, because numpy is slow where it must repeat a value.
        self._keep = np.repeat((inside > 0).astype(np.uint8)[..., None], 3, axis=2)
        self._edge = np.nonzero((inside > 0) & (inside < 3))
        self._weight = inside[self._edge][:, None] / 3

    def cut(self, picture: Picture, out: Picture) -> None:
        """The (height, width - 2 left, 3) middle of a picture, cut, into ``out``."""
        np.multiply(picture, self._keep, out=out)
        out[self._edge] = out[self._edge] * self._weight
