"""Where the picture looks: the endoscope arm's joints, the camera in its flange, its base.

R_WV = R_WB R_BF(q) R_FV. This is the only place where the camera enters; commands leave for
``<arm>_rcm`` through ``arm.R_WR.T @ camera.R_WV`` and are mapped nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import surg_core
from surg_core import camera_file
from surg_core.arm_view import Array


@dataclass(frozen=True)
class HeldCamera:
    """The left camera of an endoscope that an arm holds."""

    arm: str
    chain: surg_core.Chain  # its joints, base to flange
    R_WB: Array  # (3, 3) its base in the world of the cell
    R_FV: Array  # (3, 3) the view frame V in its flange

    def view(self, q: Array) -> Array:
        """R_WV (3, 3): the view in the world, at joint positions (n,) [rad]."""
        R_WV: Array = self.R_WB @ np.asarray(self.chain.forward(q))[:3, :3] @ self.R_FV
        return R_WV


def held_camera(cell: surg_core.Cell) -> HeldCamera | None:
    """The camera of the first arm whose instrument has one; None: no arm holds the endoscope.

    The camera in the flange is the cell's ``calibration/camera_<arm>.yaml`` where there is one,
    else the instrument's URDF.

    Raises:
        ConfigError: The calibration or the URDF must not be used.
    """
    for arm in cell.arms.values():
        if (camera := arm.instrument.camera) is not None:
            R_FV = _mounted(cell, arm, camera.frames[0])
            return HeldCamera(arm.name, arm.chain, arm.X_WB[:3, :3], R_FV)
    return None


def _mounted(cell: surg_core.Cell, arm: surg_core.Arm, frame: str) -> Array:
    file = cell.folder / "calibration" / f"camera_{arm.name}.yaml"
    if file.is_file():
        return camera_file.load_camera(file).R_FV
    mount = arm.instrument.mount_link
    X_FV = surg_core.fixed_transform(arm.instrument_urdf, mount, frame)
    return np.asarray(X_FV)[:3, :3]
