"""The endoscope in the scene: its cameras and its light, held by an arm or standing still.

An arm whose instrument has cameras carries them, and the light between them, in the tip. Without
such an arm one camera stands still where a surgeon would hold it.
"""

from __future__ import annotations

import mujoco
import numpy as np

import surg_core
from surg_sim.appearance.drawing import add_seen, look
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.pose_error import PoseError
from surg_sim.physics.spec_parts import quaternion

LEFT, RIGHT = "endoscope_left", "endoscope_right"
"""Names of the cameras, and of their optical frames on the wire."""
FRAMES = {"left": LEFT, "right": RIGHT}
"""Camera and optical frame of each view."""
LIGHT = "scope"
"""Name of the light."""
FOVY = 56.0
"""Vertical field of view of the endoscope that stands still [deg]."""

_STANDING_DISTANCE = 0.100  # [m] camera to work point
_STANDING_ELEVATION = np.radians(38.0)  # above the horizontal
_OPTICAL = np.diag([1.0, -1.0, -1.0])  # a MuJoCo camera looks along -z with y up
_BEHIND = 0.004  # [m] of the light behind the lenses, where the fibres end


def holder(arms: list[surg_core.Arm]) -> surg_core.Arm | None:
    """The arm that holds the endoscope: the first whose instrument has cameras; None: none does."""
    return next((arm for arm in arms if arm.instrument.camera is not None), None)


def cameras(arm: surg_core.Arm | None) -> tuple[str, ...]:
    """Names of the cameras that the scene has with this holder: the left one, or both."""
    two = arm is not None and arm.instrument.camera and len(arm.instrument.camera.frames) == 2
    return (LEFT, RIGHT) if two else (LEFT,)


def camera_poses(arm: surg_core.Arm, error: PoseError | None = None) -> list[Array]:
    """Optical frames (x right, y down, z away) of the holder's cameras in the flange, (4, 4) each.

    By the URDF; the true ones differ from it by ``error`` of the left camera, as one rigid pair.

    Raises:
        ValueError: A frame is not in the URDF, or the two do not fit the stated baseline.
    """
    instrument = arm.instrument
    camera = instrument.camera
    if camera is None:
        raise ValueError(f"{instrument.file}: the instrument '{instrument.name}' has no cameras")
    poses = [
        np.asarray(surg_core.fixed_transform(arm.instrument_urdf, instrument.mount_link, frame))
        for frame in camera.frames
    ]
    if len(poses) == 2:
        X = np.linalg.inv(poses[0]) @ poses[1]
        stated = np.eye(4)
        stated[0, 3] = camera.baseline
        if np.abs(X - stated).max() > 1e-6:
            raise ValueError(
                f"{instrument.file}: camera.baseline: {camera.baseline:g} m, but the right frame "
                f"lies at {np.round(X[:3, 3], 6).tolist()} m from the left one in "
                f"{arm.instrument_urdf.name}; needed are parallel frames, the right one along x"
            )
    if error is None:
        return poses
    moved = poses[0] @ error.motion() @ np.linalg.inv(poses[0])
    return [moved @ X_FV for X_FV in poses]


def add_held(spec: mujoco.MjSpec, arm: surg_core.Arm, error: PoseError | None = None) -> None:
    """Put cameras and light into the tip of the arm's instrument.

    The cameras look elsewhere than the URDF says by ``error``.

    Raises:
        ValueError: as ``camera_poses``.
    """
    drawn = camera_poses(arm)
    camera = arm.instrument.camera
    assert camera is not None
    for name, frame, X_FV, X_FTrue in zip(
        (LEFT, RIGHT), camera.frames, drawn, camera_poses(arm, error), strict=False
    ):
        X = np.eye(4) if error is None else np.linalg.inv(X_FV) @ X_FTrue
        spec.body(f"{arm.name}_{frame}").add_camera(
            name=name,
            pos=X[:3, 3].tolist(),
            quat=quaternion(X[:3, :3] @ _OPTICAL).tolist(),
            fovy=float(np.degrees(camera.fovy)),
        )
    _add_light(spec.body(f"{arm.name}_{arm.instrument.tip_link}"), np.zeros(3), np.eye(3)[2])


def add_standing(spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
    """Put one camera and its light where a surgeon would hold them; ``visuals`` draws the scope."""
    eye = site.place(
        _STANDING_DISTANCE
        * np.array([0.0, -np.cos(_STANDING_ELEVATION), np.sin(_STANDING_ELEVATION)])
    )
    forward = (site.work - eye) / _STANDING_DISTANCE
    R = look(forward, np.array([0.0, 0.0, 1.0]))
    world = spec.worldbody
    world.add_camera(name=LEFT, pos=eye.tolist(), quat=quaternion(R).tolist(), fovy=FOVY)
    _add_light(world, eye, forward)
    if not visuals:
        return
    for start, end, radius, material in (
        (0.006, 0.260, 0.005, "scope"),
        (0.255, 0.300, 0.013, "scope_head"),
        (0.300, 0.365, 0.020, "scope"),
    ):
        add_seen(
            world,
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            material,
            size=[radius, 0, 0],
            fromto=[*(eye - start * forward), *(eye - end * forward)],
        )


def _add_light(body: mujoco.MjsBody, eye: Array, forward: Array) -> None:
    body.add_light(
        name=LIGHT,
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=(eye - _BEHIND * forward).tolist(),
        dir=forward.tolist(),
        castshadow=False,
        ambient=[0.06, 0.05, 0.05],
        diffuse=[1.0, 0.97, 0.93],
        specular=[0.6, 0.6, 0.6],
        attenuation=[0.55, 0.5, 21.0],
        cutoff=62.0,
        exponent=5.0,
    )
