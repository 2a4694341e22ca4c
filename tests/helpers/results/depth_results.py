"""docs/results/depth.md: what the tests of depth and marks find."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

HEAD = """# Depth and marks

Written by `./surg test --full tests/unit/depth`: simulation, seeded. The bowel from n places with a
baseline of 4 mm, f 451 px at 640 × 480 and 2 grey levels of noise, against the renderer's depth
buffer at 50 to 120 mm. Known: share of these pixels with a depth. Times: processor time of a pair.
"""
METHODS = ("sgbm", "sgbm_half", "sgbm_8", "sgbm_wls")
CRFS = (12, 18, 23, 28)
ROWS = (
    *(f"{method}, 640 x 480" for method in METHODS),
    "sgbm, 1280 x 720",
    *(f"`./surg episode depth`, crf {crf}" for crf in CRFS),
    "marks: tip at 80 mm against its true place, after the calibration",
    "marks: the same, before it",
    "marks: two-sigma ellipse holds the true tip",
)
PAGE = ResultsPage("depth.md", HEAD, ROWS, keep=True)
