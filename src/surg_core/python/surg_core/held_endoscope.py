"""Where an endoscope that an arm holds looks, as everybody but the simulator believes it.

``X_WV = X_WB X_BF(q) X_FV``: V is the left camera (x right, y down, z away). X_FV is the cell's
``calibration/camera_<arm>.yaml`` where there is one, else the instrument's URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core import base_file, camera_file, lens_file, stereo_file
from surg_core._core import Chain, ConfigError, Joint
from surg_core.config import Arm, Cell
from surg_core.transforms import FloatArray, matrix_to_quaternion_xyzw
from surg_core.urdf import fixed_transform

LEFT, RIGHT, STEREO = "endoscope_left", "endoscope_right", "endoscope_stereo"
"""Names of the files in ``calibration/``; the first two are also the optical frames' on /tf."""


@dataclass(frozen=True, eq=False)
class HeldEndoscope:
    """An endoscope and the arm that holds it.

    Attributes:
        arm: Name of the arm.
        chain: Its joints, base to flange.
        X_WB: (4, 4) its base in the world of the cell [m].
        R_FV: (3, 3) the view frame V in the flange.
        X_FV: (4, 4) its pose [m]; None: measured by surg_camera/1, which states the rotation only.
        X_LR: (4, 4) the right camera in the left one [m]; None: there is one camera.
        measured: Whether V is measured; else it is the URDF's.
    """

    arm: str
    chain: Chain
    X_WB: FloatArray
    R_FV: FloatArray
    X_FV: FloatArray | None
    X_LR: FloatArray | None
    measured: bool

    def rotation(self, q: npt.ArrayLike) -> FloatArray:
        """R_WV (3, 3) at joint positions (n,) [rad]."""
        X_BF = np.asarray(self.chain.forward(q))
        return np.asarray(self.X_WB[:3, :3] @ X_BF[:3, :3] @ self.R_FV)

    def poses(self, q: npt.ArrayLike) -> FloatArray:
        """X_WV (N, 4, 4) at joint positions (N, n) [rad].

        Raises:
            ConfigError: Only the rotation of the camera is known.
        """
        if self.X_FV is None:
            raise ConfigError(
                f"camera_{self.arm}.yaml: format: surg_camera/1 states a rotation only; allowed "
                "here: surg_camera/2. Run ./surg calibrate CELL handeye"
            )
        return np.asarray(self.X_WB @ np.asarray(self.chain.forward_batch(q)) @ self.X_FV)

    def describe(self) -> dict[str, Any]:
        """Everything as numbers, for a manifest; :func:`from_description` is the inverse."""
        return {
            "arm": self.arm,
            "joints": [
                {
                    "name": j.name,
                    "X": np.asarray(j.X_PJ).tolist(),
                    "axis": np.asarray(j.axis).tolist(),
                }
                for j in self.chain.joints
            ],
            "X_LF": np.asarray(self.chain.X_LF).tolist(),
            "X_WB": self.X_WB.tolist(),
            "X_FV": None if self.X_FV is None else self.X_FV.tolist(),
            "R_FV": self.R_FV.tolist(),
            "X_LR": None if self.X_LR is None else self.X_LR.tolist(),
            "measured": self.measured,
        }


def from_description(described: Mapping[str, Any]) -> HeldEndoscope:
    """The endoscope of :meth:`HeldEndoscope.describe`.

    Raises:
        ConfigError: A key is missing or holds something else.
    """

    def pose(key: str, n: int = 4) -> FloatArray:
        X = np.asarray(described[key], dtype=np.float64)
        if X.shape != (n, n) or not np.isfinite(X).all():
            raise ValueError(f"{key}: {n} x {n} finite numbers are needed")
        return X

    try:
        joints = [Joint(str(j["name"]), j["X"], j["axis"]) for j in described["joints"]]
        return HeldEndoscope(
            arm=str(described["arm"]),
            chain=Chain(joints, pose("X_LF")),
            X_WB=pose("X_WB"),
            R_FV=pose("R_FV", 3),
            X_FV=None if described["X_FV"] is None else pose("X_FV"),
            X_LR=None if described["X_LR"] is None else pose("X_LR"),
            measured=bool(described["measured"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"endoscope: {type(error).__name__}: {error}") from error


def held_endoscope(cell: Cell) -> HeldEndoscope | None:
    """The endoscope of the first arm whose instrument has a camera; None: no arm holds one.

    Raises:
        ConfigError: A calibration or the URDF must not be used; a file is stale.
    """
    for arm in cell.arms.values():
        if arm.instrument.camera is not None:
            return _held(cell, arm)
    return None


def check_files(cell: Cell) -> None:
    """Refuse lens and stereo files that do not belong together.

    Raises:
        ConfigError: With file, key, what is allowed and the cure.
    """
    folder = cell.folder / "calibration"
    left, right, stereo = (folder / f"{name}.yaml" for name in (LEFT, RIGHT, STEREO))
    if left.is_file() and right.is_file():
        lenses = lens_file.load_lens(left), lens_file.load_lens(right)
        lens_file.check_eyes(*lenses, str(left), str(right))
    if stereo.is_file():
        stereo_file.check_lenses(stereo_file.load_stereo(stereo), stereo, left, right)


def _held(cell: Cell, arm: Arm) -> HeldEndoscope:
    check_files(cell)
    camera = arm.instrument.camera
    assert camera is not None
    mount, urdf = arm.instrument.mount_link, arm.instrument_urdf
    drawn = [np.asarray(fixed_transform(urdf, mount, frame)) for frame in camera.frames]
    folder = cell.folder / "calibration"
    file = folder / f"camera_{arm.name}.yaml"
    R_FV, measured = drawn[0][:3, :3], file.is_file()
    X_FV: FloatArray | None = drawn[0]
    if measured:
        found = camera_file.load_camera(file)
        lenses = folder / f"{LEFT}.yaml", folder / f"{RIGHT}.yaml"
        camera_file.check_camera_lenses(found, file, *lenses)
        R_FV, X_FV = found.R_FV, found.X_FV
    X_LR = np.linalg.inv(drawn[0]) @ drawn[1] if len(drawn) == 2 else None
    for name in cell.arms:
        base = folder / f"base_{name}.yaml"
        if base.is_file():
            base_file.check_base_camera(base_file.load_base(base), base, file)
    stereo = folder / f"{STEREO}.yaml"
    if X_LR is not None and stereo.is_file():
        X_LR = stereo_file.load_stereo(stereo).X_LR
    return HeldEndoscope(arm.name, arm.chain, arm.X_WB, R_FV, X_FV, X_LR, measured)


def pose_numbers(X: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) as (N, 7): position [m], quaternion x, y, z, w."""
    quaternions = [matrix_to_quaternion_xyzw(each[:3, :3]) for each in X]
    return np.column_stack([X[:, :3, 3], np.array(quaternions).reshape(-1, 4)])
