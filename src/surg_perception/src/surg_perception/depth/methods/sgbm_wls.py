"""Semi-global matching, smoothed along the picture's edges; needs OpenCV's contributed modules.

The filter is that of D. Min et al., "Fast global image smoothing based on weighted least squares",
IEEE TIP 23, 2014, with the matches from right to left as its confidence.
"""

from __future__ import annotations

import cv2
import numpy as np

from surg_perception.depth.rectification import PairGeometry, Picture
from surg_perception.depth.sgbm_parts import SIXTEENTHS, SemiGlobal, believed, grey
from surg_perception.depth.stereo_matcher import FAR, NEAR, Disparity, MatcherError

LAMBDA, SIGMA = 8000.0, 1.2
"""Weight of smoothness; sensitivity to edges: the filter's documented usual values."""


class SgbmWlsMatcher(SemiGlobal):
    """Three times as long as ``sgbm``."""

    def __init__(self, geometry: PairGeometry, near: float = NEAR, far: float = FAR) -> None:
        """As the interface says.

        Raises:
            MatcherError: This OpenCV has no such filter.
        """
        super().__init__(geometry, near, far)
        if not hasattr(cv2, "ximgproc"):
            raise MatcherError(
                "method sgbm_wls: this OpenCV is without its contributed modules (cv2.ximgproc); "
                "allowed: Debian's python3-opencv, which has them. Use sgbm or sgbm_8 here"
            )

    def disparity(self, left: Picture, right: Picture) -> Disparity:
        """As the interface says."""
        matcher, lowest = self._matcher()
        first, second = grey(left), grey(right)
        back = cv2.ximgproc.createRightMatcher(matcher)
        smooth = cv2.ximgproc.createDisparityWLSFilter(matcher)
        smooth.setLambda(LAMBDA)
        smooth.setSigmaColor(SIGMA)
        forth, mirrored = matcher.compute(first, second), back.compute(second, first)
        found = smooth.filter(forth, first, None, mirrored).astype(np.float32) * SIXTEENTHS
        return believed(found, lowest, first)
