#!/usr/bin/env python3
"""Step 7: export recordings as a dataset and read it back.

You learn: what a LeRobot dataset of this platform holds. ``./surg episode export`` does the same
and knows more formats (robomimic, ACT, diffusion policy); docs/reference/datasets.md lists every
feature.

    ./surg dev shell -c "python3 examples/07_export.py"        # writes runs/course/dataset
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pyarrow import parquet

from surg_recording import datasets


def main() -> None:
    """Export the episodes of step 5, then look into the dataset."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("episodes", type=Path, nargs="?", default=Path("runs/course/episodes"))
    parser.add_argument("--out", type=Path, default=Path("runs/course/dataset"))
    options = parser.parse_args()
    if not options.episodes.is_dir():
        raise SystemExit(f"{options.episodes}: no such folder; run examples/05_recording.py first")
    wanted = datasets.ExportOptions(fps=20, splits={"train": 0.9, "val": 0.1}, replace=True)
    report = datasets.load("lerobot").write([options.episodes], options.out, wanted)
    if not report.ok:
        raise SystemExit("; ".join([*report.errors, *report.refused.values()]))
    print(f"{report.recordings} episodes, {report.frames} frames at 20 Hz -> {options.out}")

    info = json.loads((options.out / "meta" / "info.json").read_text("utf-8"))
    for name in ("observation.state", "privileged.task_state", "action"):
        print(f"{name}: {', '.join(info['features'][name]['names'])}")
    first = next((options.out / "data").rglob("*.parquet"))
    frame = parquet.read_table(first).to_pylist()[0]
    print("first action [m, rad]:", [round(value, 4) for value in frame["action"]])


if __name__ == "__main__":
    main()
