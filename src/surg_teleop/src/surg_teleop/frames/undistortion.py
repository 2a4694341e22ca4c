"""Takes the lens out of the places of the tip: pixels of parallel pinholes with one camera matrix.

A lens bends the paths of the tip, and eyes that are not quite parallel shift them. The check reads
directions from pixels, so it needs pixels of pinholes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from surg_core.arm_view import Array
from surg_teleop.frames.probe_moves import ProbeMove
from surg_teleop.frames.tip_tracker import Place


@dataclass(frozen=True)
class EyeModel:
    """One eye as its ``camera_info`` states it.

    Attributes:
        K: (3, 3) camera matrix [px].
        D: Coefficients of the distortion.
        model: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
        R: (3, 3) rotation from the eye to its rectified one.
    """

    K: Array
    D: Array
    model: str
    R: Array

    def straight(self, pixel: Array, turn: Array, K: Array) -> Array:
        """The pixel (2,) of a pinhole with K (3, 3), turned by (3, 3) from this eye."""
        points = np.asarray(pixel, dtype=np.float64).reshape(1, 1, 2)
        if self.model == "equidistant":
            found = cv2.fisheye.undistortPoints(points, self.K, self.D, None, turn, K)
        else:
            found = cv2.undistortPoints(points, self.K, self.D, None, turn, K)
        return np.asarray(found, dtype=np.float64).reshape(2)


def straighten(
    places: Mapping[ProbeMove, Place], left: EyeModel, right: EyeModel | None
) -> dict[ProbeMove, Place]:
    """The places as two parallel pinholes see them, both with the left eye's camera matrix.

    The left pinhole looks where the left eye looks. Pinholes that are parallel already change
    nothing.
    """
    other = left if right is None else right
    turn = left.R.T @ other.R
    parallel = np.array_equal(turn, np.eye(3)) and np.array_equal(left.K, other.K)
    if parallel and not left.D.any() and not other.D.any():
        return dict(places)
    straight = {}
    for step, place in places.items():
        pixel = left.straight(place.left, np.eye(3), left.K)
        disparity = place.disparity
        if right is not None and disparity is not None:
            disparity = pixel - right.straight(place.left - disparity, turn, left.K)
        straight[step] = replace(place, left=pixel, disparity=disparity)
    return straight
