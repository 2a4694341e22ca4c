"""From a pair of pictures to metric depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from surg_core.lens_file import Lens
from surg_perception.depth.rectification import PairGeometry, Picture, StereoRectifier
from surg_perception.depth.stereo_matcher import FAR, NEAR, Disparity, find_matcher


@dataclass(frozen=True)
class DepthPicture:
    """What one pair gives, all in the left rectified eye.

    Attributes:
        left: (h, w, 3) rgb8, rectified.
        right: The right eye's.
        disparity: (h, w) [px]; NaN: unknown.
        depth: (h, w) distance along the axis [m]; NaN: unknown.
    """

    left: Picture
    right: Picture
    disparity: Disparity
    depth: npt.NDArray[np.float32]

    @property
    def known(self) -> float:
        """Share of the pixels with a depth."""
        return float(np.isfinite(self.depth).mean())


class StereoDepth:
    """Depth of pairs of one calibrated endoscope. Everything that can be is computed once.

    Args:
        left: Lens of the left eye, for the pictures' size.
        right: Lens of the right eye.
        size: Of the rectified pictures [px]; None: of the pictures. Smaller is faster.
        method: A name of `stereo_matcher.MATCHERS`, or the path of a ``.py`` file.
        near: Smallest distance that is looked for [m].
        far: Largest one [m].

    Raises:
        ConfigError: The lenses make no pair.
        MatcherError: The method cannot be used.
    """

    def __init__(
        self,
        left: Lens,
        right: Lens,
        size: tuple[int, int] | None = None,
        method: str = "sgbm",
        near: float = NEAR,
        far: float = FAR,
    ) -> None:
        self.rectifier = StereoRectifier(left, right, size)
        self._matcher = find_matcher(method, self.geometry, near, far)
        self.near, self.far = near, far

    @property
    def geometry(self) -> PairGeometry:
        """Of the rectified pair."""
        return self.rectifier.geometry

    def look(self, left: Picture, right: Picture) -> DepthPicture:
        """Rectify a pair (h, w, 3), rgb8, and find its depth.

        Raises:
            ValueError: The pictures have another size than their lenses, or the method fails.
        """
        first, second = self.rectifier.rectify(left, right)
        disparity = self._matcher.disparity(first, second)
        depth = self.geometry.depth(disparity)
        depth[(depth < self.near) | (depth > self.far)] = np.nan
        return DepthPicture(first, second, disparity, depth)
