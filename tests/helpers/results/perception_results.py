"""docs/results/perception.md: what the tests of the endoscope's calibration find."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

HEAD = """# Calibration of an endoscope

Written by `./surg test --full` (`tests/unit/perception`, `tests/unit/collecting`,
`tests/ros/perception`): simulation, seeded. Each seed draws a barrel lens, a camera up to 10 mm and
5° off its drawing, a base up to 15 mm and 3° off. Joints have 2e-5 rad of noise, corners 0.05 px.
"""
SIZES = ((640, 480), (960, 540), (1280, 720))
ROWS = (
    *(f"stereo, 20 boards, {w} x {h}, {lens}" for w, h in SIZES
      for lens in ("pinhole", "barrel")),
    "stereo pose, 20 views",
    "hand-eye through the trocar, 15 views",
    "hand-eye with exact joints, 15 views",
    "base by touch, 32 touches of 0.1 mm",
    "base by tip, found in 12 rendered pairs with noise",
    "whole chain, joints against picture at 80 mm",
    "check-frames, base 3°, camera 15° and lens unknown",
    "./surg check-frames, base 2°, camera 4° and lens unknown",
    "the guide's steps, rendered",
    "calibrated from a running system, 20 views, 15 postures, 32 touches",
)  # fmt: skip
PAGE = ResultsPage("perception.md", HEAD, ROWS, keep=True)
