"""docs/results/screens.md: times of the 3D monitor and the headset's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from helpers.results.results_page import ResultsPage

_HEAD = """# Screens: times

Written by `./surg test --full tests/e2e/test_monitor_page.py`: headless Chromium without a graphics
card. *Draw* is one picture of two eyes of 640 × 480, shifted by 3.5 %, on a canvas of 1920 × 1080
(frame packing: 1920 × 2205), read back: processor time of the whole browser, and the fastest
picture by the clock.

| what | pictures | result |
|---|---|---|
"""
FORMATS = (
    *("left", "right", "sbs", "top_bottom", "rows", "columns", "checker", "anaglyph"),
    "frame_packed",
)
PAGE = ResultsPage("screens.md", _HEAD, [f"draw {form}" for form in FORMATS], keep=True)


def note_times(
    form: str, spent: float, times: Sequence[float], limits: Mapping[str, float]
) -> None:
    """Print and keep what a picture of a format costs.

    Args:
        form: Of `FORMATS`.
        spent: Processor time of the browser for one picture [ms].
        times: Of each picture by the clock [ms].
        limits: Goals [ms].
    """
    goal = f", goal {limits[form]:.0f}" if form in limits else ""
    result = f"{spent:.1f} ms of processor time{goal}; by the clock at best {min(times):.1f} ms"
    PAGE.note(f"draw {form}", len(times), result)
