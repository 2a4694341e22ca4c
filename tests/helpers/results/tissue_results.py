"""docs/results/tissue.md: what the tests of bowel, grasp and assistant measured in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Tissue, grasp, assistant

Written by `./surg test --full` (`tests/unit/sim/test_sim_tissue.py`, `test_sim_grasp.py`,
`test_sim_assistant.py`): simulation, seeded.
"""
ROWS = (
    "a drawn shape is at rest",
    "a kick dies out in 1 s",
    "pulls of up to 100 N at three nodes",
    "tension along the tube against statics",
    "mirrored pulls",
    "the bed breathes",
    "jaws that close round the tube hold",
    "slow pulls: slip, slip, loss",
    "force on the jaws against statics",
    "5 N at the assistant's tip",
    "the assistant's tip against its virtual joints",
)
"""All rows, in order."""
note = ResultsPage("tissue.md", _HEAD, ROWS).note
