"""Semi-global matching of pictures of half the size: a quarter of the time, twice the error."""

from __future__ import annotations

import cv2
import numpy as np

from surg_perception.depth.rectification import Picture
from surg_perception.depth.sgbm_parts import SIXTEENTHS, SemiGlobal, believed, grey, semi_global
from surg_perception.depth.stereo_matcher import Disparity


class SgbmHalfMatcher(SemiGlobal):
    """The result has the size of the pictures."""

    def disparity(self, left: Picture, right: Picture) -> Disparity:
        """As the interface says."""
        height, width = left.shape[:2]
        size = ((width + 1) // 2, (height + 1) // 2)
        scale = width / size[0]
        small = [cv2.resize(grey(p), size, interpolation=cv2.INTER_AREA) for p in (left, right)]
        matcher, lowest = semi_global(self.least / scale, self.most / scale, self.mode)
        found = matcher.compute(*small).astype(np.float32) * SIXTEENTHS
        known = believed(found, lowest, small[0])
        whole: Disparity = cv2.resize(known, (width, height), interpolation=cv2.INTER_NEAREST)
        return whole * np.float32(scale)
