"""How fast the whole graph runs: lock-step against real time, and the loop's timing in free-run."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from surg_cli.host import paths


def measure(seconds: float, *options: str) -> dict[str, Any]:
    """Run the demonstration once.

    Args:
        seconds: Length of motion played.
        *options: Further options of `./surg demo`.

    Returns:
        Wall time [s] and the summary's figures on timing.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        argv = [str(paths.ROOT / "surg"), "demo", "--duration", str(seconds), "--out", str(out)]
        started = time.monotonic()
        done = subprocess.run([*argv, *options], capture_output=True, text=True, check=False)
        wall = time.monotonic() - started
        summary_file = out / "summary.json"
        if not summary_file.exists():
            sys.exit(f"{' '.join(argv)} failed:\n{done.stderr}")
        summary = json.loads(summary_file.read_text("utf-8"))
    return {
        "options": options,
        "exit_status": done.returncode,
        "motion_s": summary["duration_s"],
        "wall_s": round(wall, 1),
        "controller": summary["controller"],
    }


def main() -> None:
    """Measure lock-step and free-run, each with and without the camera."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=20.0, help="seconds of motion per run")
    options = parser.parse_args()
    for flags in ((), ("--no-video",), ("--free-run",), ("--free-run", "--no-video")):
        print(json.dumps(measure(options.duration, *flags)), flush=True)


if __name__ == "__main__":
    main()
