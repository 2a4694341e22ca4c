"""docs/results/tissue.md: what the tests of bowel, grasp and assistant measured in a whole run."""

from __future__ import annotations

import os
from pathlib import Path

_HEAD = """# Tissue, grasp, assistant

Written by `./surg test --full` (`tests/unit/test_sim_tissue.py`, `test_sim_grasp.py`,
`test_sim_assistant.py`): figures of simulation, seeded.

| what | cases | result |
|---|---|---|
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
_found: dict[str, tuple[int, str]] = {}


def note(row: str, cases: int, result: str) -> None:
    """Print a figure, keep it, and write the page once all are there and it is asked for."""
    if row not in ROWS:
        raise KeyError(row)
    print(f"{row}: {cases}: {result}")
    _found[row] = (cases, result)
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder and len(_found) == len(ROWS):
        lines = [f"| {row} | {_found[row][0]} | {_found[row][1]} |\n" for row in ROWS]
        Path(folder, "tissue.md").write_text(_HEAD + "".join(lines), "utf-8")
