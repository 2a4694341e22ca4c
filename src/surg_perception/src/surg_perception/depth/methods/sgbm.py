"""OpenCV's semi-global matching, with what is known of its weaknesses taken out: the default.

H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", IEEE TPAMI 30,
2008.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from surg_perception.depth.rectification import Picture
from surg_perception.depth.stereo_matcher import Disparity, StereoMatcher

BLOCK = 5
"""[px] Side of the blocks that are compared."""
DARK = 12
"""[grey levels] Below it nothing is lit: outside the round picture of an endoscope."""
SIXTEENTHS = np.float32(1.0 / 16.0)


class SgbmMatcher(StereoMatcher):
    """Matches along three directions: about 38 ms for 640 x 480 on one core.

    What finds no partner often ends at the smallest disparity of the range, so one more is looked
    for than is believed: without it the 90th percentile of the error was 3.3 mm instead of 2.7.

    Attributes:
        mode: The directions.
        slow: Smooth inside edges too, for 15 ms; worth it where video was compressed.
    """

    mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
    slow = False

    def disparity(self, left: Picture, right: Picture) -> Disparity:
        """As the interface says; unknown at the range's end and where nothing is lit."""
        lowest = math.floor(self.least) - 1
        count = 16 * math.ceil((self.most - lowest + 1) / 16)
        P1, P2 = 8 * BLOCK**2, 32 * BLOCK**2
        matcher = cv2.StereoSGBM_create(lowest, count, BLOCK, P1, P2, 1, 31, 5, 100, 2, self.mode)
        first, second = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (left, right))
        found = matcher.compute(first, second).astype(np.float32) * SIXTEENTHS
        smooth: Disparity = cv2.medianBlur(found, 5)
        unknown = (smooth < lowest + 1) | (first < DARK)
        if self.slow:
            smooth = cv2.bilateralFilter(smooth, 9, 1.0, 4.0)
        smooth[unknown] = np.nan
        return smooth
