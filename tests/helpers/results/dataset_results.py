"""docs/results/datasets.md: what the tests of datasets counted in a whole run."""

from __future__ import annotations

import os
from pathlib import Path

from helpers.results.results_page import ResultsPage

_HEAD = """# Datasets

Written by `./surg test --full` (`test_datasets_resample.py`, `test_datasets_export.py` and
`test_datasets_scale.py` in `tests/unit/datasets`).

| what | cases | result |
|---|---|---|
"""
ROWS = (
    "grid times against exact fractions",
    "resampler against brute force, scipy, geometry",
    "pictures in their place: lerobot",
    "pictures in their place: lerobot_v30",
    "pictures in their place: robomimic",
    "pictures in their place: act",
    "pictures in their place: diffusion_policy",
    "the same with all pictures stamped a frame late",
    "broken recordings",
    "recordings with a Dask worker killed on the way",
)
"""All rows, in order."""
_found: dict[str, tuple[int, str]] = {}


def note(row: str, cases: int, result: str) -> None:
    """Print a figure, keep it (cases of one row add up), write the page once all are there."""
    if row not in ROWS:
        raise KeyError(row)
    print(f"{row}: {cases}: {result}")
    _found[row] = (cases + _found.get(row, (0, ""))[0], result)
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder and len(_found) == len(ROWS):
        lines = [f"| {row} | {_found[row][0]} | {_found[row][1]} |\n" for row in ROWS]
        Path(folder, "datasets.md").write_text(_HEAD + "".join(lines), "utf-8")


_READERS_HEAD = """# Datasets in the programs that they are for

Written by `./surg test --full --tier oracle tests/unit/datasets/test_datasets_oracle.py`: the real
readers, each in an environment of its own, in random order. A picture says which recording, camera
and frame it is of.

| reader | frames or sequences | result |
|---|---|---|
"""
_PROGRAMS = ("lerobot 0.3.3", "lerobot 0.4.4", "robomimic 0.3.0")
READERS = ResultsPage(
    "readers.md",
    _READERS_HEAD,
    [row for name in _PROGRAMS for row in (name, f"{name}, all pictures stamped a frame late")],
)
"""docs/results/readers.md: what the real readers found."""

LONG = ResultsPage(
    "long_recording.md",
    """# A 30-minute stereo episode

Written by `./surg test --full --tier oracle tests/unit/datasets/test_datasets_thirty_minutes.py`,
`-- -k copy` or `-- -k encode`: 2 x 640 x 480 at 20 frames per second with grain, forces, 500 cycles
per second, in simulated time. Memory is the peak of each process (resident, shared libraries
included); a worker of an export may use 300 MiB.

| step | minutes or frames | result |
|---|---|---|
""",
    (
        "recorded",
        *(
            f"{step}, `--video {video}`"
            for video in ("copy", "encode")
            for step in ("exported as LeRobot 3.0", "opened by lerobot 0.4.4")
        ),
    ),
    keep=True,
)
"""docs/results/long_recording.md."""
