"""docs/results/teleoperation.md: hand, picture and tip; random operators; a bad cable."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Teleoperation

Written by `SURG_TEST_MOTION=FILE ./surg test --full tests/unit/teleop
tests/ros/system/test_two_machines.py`. *Lag*: a hand at 30 Hz and scale 1, UR5e, without the wire.
*Picture*: the tip in rendered pictures, 640 × 480, the endoscope moved during one engagement.
"""
DELAYS, STALLS = (0, 5, 20, 50), (100, 200, 300, 500, 1000)
"""[ms] On the cable; 300 in the normal tier."""
STORMS = "storms of 14 random events"
PULLED, MENDED = "cable pulled", "cable mended after 1 s"
_PAGE = ResultsPage(
    "teleoperation.md",
    _HEAD,
    (
        *("lag: synthetic", "lag: recording"),
        *("picture: sim_two_arms", "picture: sim_two_arms_panda"),
        STORMS,
        *(f"cable: {ms} ms each way" for ms in DELAYS),
        "cable: motion",
        *(f"cable: stall of {ms} ms" for ms in STALLS),
        *(PULLED, MENDED),
    ),
    keep=True,
)
note = _PAGE.note
