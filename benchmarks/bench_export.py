"""Exported frames per second beside lerobot's own writer, with the same codec and settings.

A frame is a pair of pictures with its numbers. Both decode the same recordings and encode H.264 at
crf 30 with a key frame every second frame and x264's preset "medium" (lerobot's). Ours also
resamples all tables and reads everything back; lerobot writes each picture as a PNG file first.
lerobot is measured where its environment is there (made by `./surg test --tier oracle`).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.host import paths
from surg_cli.host.terminal import Progress, say, table, warn

sys.path.insert(0, str(paths.ROOT / "tests"))
from helpers.recording import datasets_synthetic
from helpers.recording.picture_identity import Identity
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

LEROBOT = "0.4.4"
SAME = ExportOptions(crf=30, gop=2, preset="medium", splits={"train": 1.0})


def main() -> int:
    """Measure; print a table; write JSON."""
    parser = argparse.ArgumentParser(prog="./surg bench export", description=__doc__)
    add = parser.add_argument
    add("episodes", nargs="*", type=Path, help="recordings (default: made up, with texture)")
    add("--seconds", type=float, default=10.0, metavar="S", help="of each made-up recording")
    add("--recordings", type=int, default=2, metavar="N", help="made-up recordings (default 2)")
    add("--json", type=Path, metavar="FILE", help="the figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        recordings = options.episodes or made_up(root, options.recordings, options.seconds)
        rows = [measured(root, recordings, executor) for executor in ("serial", "process")]
        rows += theirs(root, recordings)
        rows.append(measured(root, recordings, "process", ExportOptions(splits={"train": 1.0})))
    for row in rows:
        row["frames_per_s"] = row["frames"] / row["wall_s"]
        row["cpu_ms_per_frame"] = 1000 * row["cpu_s"] / row["frames"]
    shown = [["writer", "frames", "frames/s", "CPU ms per frame"]]
    for row in rows:
        figures = [row["frames"], f"{row['frames_per_s']:.1f}", f"{row['cpu_ms_per_frame']:.1f}"]
        shown.append([row["writer"], *map(str, figures)])
    say(table(shown))
    if options.json is not None:
        machine = {"cpus": len(os.sched_getaffinity(0)), "machine": platform.machine()}
        paths.write_text(options.json, json.dumps({**machine, "rows": rows}, indent=1) + "\n")
    return 0


def measured(
    root: Path, recordings: list[Path], executor: str, options: ExportOptions = SAME
) -> dict[str, Any]:
    """Our export of the recordings, in time."""
    out = root / f"ours_{executor}_{options.preset}"
    chosen = dataclasses.replace(options, executor=executor)
    started, used = time.monotonic(), _cpu()
    report = datasets.load("lerobot_v30").write(recordings, out, chosen)
    wall, cpu = time.monotonic() - started, _cpu() - used
    if not report.ok:
        sys.exit(f"the export failed: {report.errors or report.refused}")
    name = f"ours, {executor}, crf {options.crf}, preset {options.preset}"
    return {"writer": name, "frames": report.frames, "wall_s": wall, "cpu_s": cpu}


def theirs(root: Path, recordings: list[Path]) -> list[dict[str, Any]]:
    """Lerobot's own writer in its environment; none where that is missing."""
    python = paths.ROOT / f".venv-oracle-lerobot-{LEROBOT}" / "bin" / "python"
    if not python.exists():
        warn(f"no {python.parents[1].name}: lerobot is not measured (./surg test --tier oracle)")
        return []
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    env.update(HF_HUB_OFFLINE="1", HF_HOME=str(root / "hf"))
    script = paths.ROOT / "benchmarks" / "lerobot_writer.py"
    argv = [str(python), str(script), str(root / "theirs"), str(SAME.fps), *map(str, recordings)]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"lerobot's writer failed:\n{done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return [{"writer": f"lerobot {found['lerobot']}, crf 30, preset medium", **found}]


def made_up(root: Path, count: int, seconds: float) -> list[Path]:
    """Stereo recordings of 640 x 480 with a moving texture, which costs an encoder something."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (40, 60, 3)).astype(float)
    wide = np.kron(coarse, np.ones((16, 16, 1)))
    grain = rng.normal(0, 6, (480, 640, 3))

    def picture(identity: Identity, width: int, height: int) -> np.ndarray:
        at = 3 * identity.frame % (wide.shape[1] - width), 2 * identity.frame % 100
        image = wide[at[1] : at[1] + height, at[0] : at[0] + width]
        image = image + np.roll(grain, identity.frame, axis=1)
        return np.clip(image, 0, 255).astype(np.uint8)

    made = []
    with Progress("making recordings") as progress:
        for number in range(count):
            progress.update(number / count)
            folder = root / f"recording{number}"
            made.append(
                datasets_synthetic.record(folder, number, seconds, size=(640, 480), picture=picture)
            )
    return made


def _cpu() -> float:
    """Processor time of this process and its ended children [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(t.ru_utime + t.ru_stime for t in used)


if __name__ == "__main__":
    sys.exit(main())
