"""Puts a look on a scene and on its pictures.

The scene of the physics is never touched: a look is put on a copy, which the renderer draws. So the
next episode begins from the scene as it was built.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from surg_core.transforms import axis_angle_to_matrix, make_pose
from surg_sim.appearance.domain_randomization import TISSUES, Appearance, TissueAppearance
from surg_sim.appearance.lens import EndoscopeLens
from surg_sim.arrays import Array, Picture
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.endoscope_rig import FRAMES, LIGHT
from surg_sim.physics.spec_parts import quaternion

_STATED_HEIGHT = 480  # [px] of the picture in which a blur is stated


def dressed(model: mujoco.MjModel, look: Appearance) -> tuple[mujoco.MjModel, list[int]]:
    """A copy of a scene in an appearance, and the textures that differ in it."""
    worn = copy.copy(model)
    light = worn.light(LIGHT)
    warmth = look.light_warmth
    factor = look.light_strength * np.array([1.0 + warmth, 1.0, 1.0 - warmth])
    for part in (light.ambient, light.diffuse, light.specular):
        part[:] *= factor
    textures = []
    for name, tissue in zip(TISSUES, look.tissues, strict=True):
        if mujoco.mj_name2id(worn, mujoco.mjtObj.mjOBJ_MATERIAL, name) >= 0:
            worn.material(name).specular[:] *= tissue.gloss
            textures.append(_dye(worn, name, tissue))
    _move(worn, look)
    return worn, textures


def _dye(model: mujoco.MjModel, name: str, look: TissueAppearance) -> int:
    """Change a texture in its place; returns its number."""
    texture = model.texture(name)
    number, start = int(texture.id), int(model.tex_adr[texture.id])
    rows, columns = int(texture.height[0]), int(texture.width[0])
    place = slice(start, start + 3 * rows * columns)
    picture = model.tex_data[place].reshape(rows, columns, 3).astype(np.float32)
    mean = picture.mean(axis=(0, 1))
    picture = (mean + look.contrast * (picture - mean)) * np.array(look.colour, np.float32)
    by = [round(share * side) for share, side in zip(look.shift, (rows, columns), strict=True)]
    picture = np.roll(picture, by, axis=(0, 1))  # the textures repeat without a seam
    model.tex_data[place] = np.clip(np.rint(picture), 0, 255).astype(np.uint8).ravel()
    return number


def turn(vector_deg: tuple[float, ...]) -> Array:
    """Rotation matrix (3, 3) of a rotation vector [deg]; missing axes are 0."""
    vector = np.radians([*vector_deg, 0.0, 0.0])[:3]
    angle = float(np.linalg.norm(vector))
    return np.eye(3) if angle == 0.0 else axis_angle_to_matrix(vector / angle, angle)


def _move(model: mujoco.MjModel, look: Appearance) -> None:
    """Move cameras and light as one piece, then tilt the light.

    They hang on bodies of one rigid instrument, so any posture gives the same places in it.
    """
    if not np.any([*look.camera_shift_mm, *look.camera_turn_deg, *look.light_tilt_deg]):
        return  # not even by rounding
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    X_WV = EndoscopeView(model, data).pose
    D = make_pose(np.array(look.camera_shift_mm) / 1000.0, turn(look.camera_turn_deg))
    M = X_WV @ D @ np.linalg.inv(X_WV)
    for name in FRAMES.values():
        camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if camera < 0:
            continue
        R_WBody, p = _body(data, int(model.cam_bodyid[camera]))
        R_WC = data.cam_xmat[camera].reshape(3, 3)
        model.cam_quat[camera] = quaternion(R_WBody.T @ M[:3, :3] @ R_WC)
        model.cam_pos[camera] = R_WBody.T @ (M[:3, :3] @ data.cam_xpos[camera] + M[:3, 3] - p)
    light = int(model.light(LIGHT).id)
    R_WBody, p = _body(data, int(model.light_bodyid[light]))
    R_WV = M[:3, :3] @ X_WV[:3, :3]
    tilt = R_WV @ turn(look.light_tilt_deg) @ R_WV.T
    model.light_pos[light] = R_WBody.T @ (M[:3, :3] @ data.light_xpos[light] + M[:3, 3] - p)
    model.light_dir[light] = R_WBody.T @ tilt @ M[:3, :3] @ data.light_xdir[light]


def _body(data: mujoco.MjData, body: int) -> tuple[Array, Array]:
    """Orientation (3, 3) and place (3,) [m] of a body in the world."""
    return data.xmat[body].reshape(3, 3), data.xpos[body]


class Finish:
    """What lens and sensor do to the picture: blur, a dark edge, exposure.

    Raises:
        ImportError: The look is blurred, and OpenCV is not installed.
    """

    def __init__(self, look: Appearance, width: int, height: int) -> None:
        self._blur = look.blur_px * height / _STATED_HEIGHT
        if self._blur > 0.0:
            import cv2  # only a blur needs it: the rest of the package runs without OpenCV

            self._gaussian = cv2.GaussianBlur
        light = look.exposure * EndoscopeLens(edge=look.edge).light(width, height)
        self._gain = None if np.all(light == 1.0) else light[..., None].astype(np.float32)

    def __call__(self, picture: Picture) -> Picture:
        """The picture (height, width, 3) as this look has it; values beyond 255 become white."""
        if self._blur > 0.0:
            picture = np.asarray(self._gaussian(picture, (0, 0), self._blur))
        if self._gain is None:
            return picture
        return np.minimum(picture * self._gain + 0.5, 255.0).astype(np.uint8)
