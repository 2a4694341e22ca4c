"""Rectified pictures: both eyes as two parallel pinholes side by side, by their lens files.

The maps are computed once. One remap takes the lens out, turns the eye and scales.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from surg_core import ConfigError
from surg_core.lens_file import Lens, check_eyes, resizing
from surg_core.transforms import FloatArray

Picture = npt.NDArray[np.uint8]

BAND = 0.01
"""Largest difference of both rectified cameras' focal lengths and rows, relative and [px]."""


@dataclass(frozen=True)
class PairGeometry:
    """Two parallel pinholes; pixels are counted from the centre of the upper left one.

    Attributes:
        size: Width and height of the rectified pictures [px].
        f: Focal length across [px].
        fy: Focal length down [px].
        cx: Principal point of the left eye [px].
        cy: Principal point of both eyes [px].
        shift: Principal point of the left eye less the right one's [px]: disparity at infinity.
        baseline: The right eye lies this far to the right of the left one [m].
    """

    size: tuple[int, int]
    f: float
    fy: float
    cx: float
    cy: float
    shift: float
    baseline: float

    def depth(self, disparity: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Distance before the left eye along its axis [m] of disparities [px]; NaN stays NaN."""
        away = np.asarray(disparity, np.float32) - np.float32(self.shift)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.float32(self.f * self.baseline) / away
        return np.where(away > 0.0, z, np.float32(np.nan))

    def disparity(self, depth: float) -> float:
        """Disparity [px] of what is this far [m] before the left eye."""
        return self.f * self.baseline / depth + self.shift

    def points(self, depth: npt.NDArray[np.float32], step: int = 1) -> npt.NDArray[np.float32]:
        """Points of a depth picture in the left rectified eye: x right, y down, z away.

        Args:
            depth: (h, w) [m]; NaN: unknown.
            step: Take every so-manieth row and column.

        Returns:
            (h', w', 3) [m]; NaN where the depth is unknown.
        """
        z = depth[::step, ::step]
        x = (np.arange(0, depth.shape[1], step, dtype=np.float32) - np.float32(self.cx)) / self.f
        y = (np.arange(0, depth.shape[0], step, dtype=np.float32) - np.float32(self.cy)) / self.fy
        return np.stack([x[None, :] * z, y[:, None] * z, z], axis=-1).astype(np.float32)


class StereoRectifier:
    """Takes the lenses of a calibrated pair out of its pictures.

    Args:
        left: The left eye's lens, of the pictures' size or aspect.
        right: The right eye's.
        size: Width and height of the rectified pictures [px]; None: of the pictures.

    Raises:
        ConfigError: The lenses make no pair: other sizes, swapped eyes, not rectified together.
    """

    def __init__(self, left: Lens, right: Lens, size: tuple[int, int] | None = None) -> None:
        check_eyes(left, right, left.camera_name, right.camera_name)
        _check_parallel(left, right)
        self.raw_size = (left.width, left.height)
        size = size or self.raw_size
        change = resizing(self.raw_size, size)
        P_left, P_right = change @ left.P, change @ right.P
        self.geometry = PairGeometry(
            size=size,
            f=float(P_left[0, 0]),
            fy=float(P_left[1, 1]),
            cx=float(P_left[0, 2]),
            cy=float(P_left[1, 2]),
            shift=float(P_left[0, 2] - P_right[0, 2]),
            baseline=right.baseline,
        )
        self._maps = [_maps(left, P_left[:, :3], size), _maps(right, P_right[:, :3], size)]

    def rectify(self, left: Picture, right: Picture) -> tuple[Picture, Picture]:
        """Both rectified pictures; black where an eye does not see.

        Args:
            left: (h, w) or (h, w, 3) of the lenses' size.
            right: The same.

        Raises:
            ValueError: A picture has another size than its lens.
        """
        pictures = []
        for name, picture, (first, second) in zip(
            ("left", "right"), (left, right), self._maps, strict=True
        ):
            if picture.shape[:2] != self.raw_size[::-1]:
                raise ValueError(
                    f"the {name} picture has {picture.shape[1]} x {picture.shape[0]}, its lens is "
                    f"for {self.raw_size[0]} x {self.raw_size[1]}; allowed: equal sizes"
                )
            pictures.append(cv2.remap(picture, first, second, cv2.INTER_LINEAR))
        return pictures[0], pictures[1]


def _maps(lens: Lens, P: FloatArray, size: tuple[int, int]) -> tuple[npt.NDArray, npt.NDArray]:
    """Where each rectified pixel lies in the raw picture, as OpenCV's fixed-point maps."""
    make = cv2.initUndistortRectifyMap
    if lens.distortion_model == "equidistant":
        make = cv2.fisheye.initUndistortRectifyMap
    first, second = make(lens.K, lens.D, lens.R, P, size, cv2.CV_16SC2)
    return first, second


def _check_parallel(left: Lens, right: Lens) -> None:
    """Refuse two rectified cameras with other focal lengths or rows."""
    scale = np.abs(right.P[[0, 1], [0, 1]] / left.P[[0, 1], [0, 1]] - 1.0).max()
    row = abs(left.P[1, 2] - right.P[1, 2])
    if scale > BAND or row > BAND:
        raise ConfigError(
            f"{right.camera_name}: projection_matrix.data: f {right.P[0, 0]:g}, row "
            f"{right.P[1, 2]:g} px, in {left.camera_name} f {left.P[0, 0]:g}, row "
            f"{left.P[1, 2]:g} px: they were not measured together; allowed: equal ones. Repeat "
            "./surg calibrate CELL stereo"
        )
