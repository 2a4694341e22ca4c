"""The recorder beside `rosbag record` of the same topics in one run; and a whole episode in step.

`--json FILE` writes:

    format       "surg_bench_recording/1"
    machine      {processor, cores, load_before, load_after, date}
    freerun      {seconds, recorder, rosbag, messages {topic: {rows, rosbag}}, drops {name: count},
                 cycle_drops, missing_ticks, repeats, reason}; recorder and rosbag are {cpu_s,
                 cpu_percent, mb_per_min}, the recorder's also {node_cpu_s, encoders_cpu_s}; CPU is
                 user and system time; both over the same seconds of wall clock
    lockstep     {ticks, rows {table: count}, frames {camera: count}, expected_frames, complete,
                 reason, real_time_factor}; null with --no-lockstep
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "recording"))

import recording_page
import side_by_side
from machine import this_machine
from publish import publish

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress

TASK, ROBOT, CAMERAS = "bgr", "ur5e", "stereo"


def in_process(part: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Run one part in a process of its own: a process belongs to one ROS master for good."""
    file = folder / f"{part}.json"
    argv = [sys.executable, __file__, "--part", part, "--seconds", str(seconds)]
    argv += ["--json", str(file), "--out", str(folder / part)]
    with Progress(part):
        done = subprocess.run(argv, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not file.exists():
        words = (done.stderr or done.stdout).strip().splitlines()[-12:]
        raise CliError(f"{part}: " + ("\n".join(words) or f"ended with {done.returncode}"))
    result = json.loads(file.read_text("utf-8"))
    assert isinstance(result, dict)
    return result


def lockstep(folder: Path) -> dict[str, Any]:
    """A whole episode with two views in lock-step: complete to the tick?"""
    from real_time_factor import real_time_factor

    from surg_recording.episode import episode_reader

    folder.mkdir(parents=True)
    factor = real_time_factor(TASK, ROBOT, 0, folder, CAMERAS)
    recorded = episode_reader.read(folder / "episode")
    tables, videos = recorded.manifest["tables"], recorded.manifest["videos"]
    ticks = int(recorded.manifest["sim"]["tick"])
    named = {n: e["rows"] for n, e in tables.items() if n.startswith(("cycle_", "ground_truth_"))}
    frames = {name: entry["frames"] for name, entry in videos.items()}
    missing = {n: e["missing_ticks"] for n, e in tables.items() if n in named}
    return {
        "ticks": ticks,
        "rows": named,
        "missing_ticks": missing,
        "frames": frames,
        "expected_frames": ticks // 25,
        "complete": recorded.complete,
        "reason": recorded.manifest["reason"],
        "real_time_factor": factor,
    }


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="bench recording", description=(__doc__ or "")[:110])
    add = parser.add_argument
    add("--json", type=Path, metavar="FILE")
    add("--seconds", type=float, default=20.0, help="measured in free-run (default 20)")
    add("--no-lockstep", action="store_true", help="leave the episode in lock-step out")
    add("--page", action="store_true", help="renew docs/results/benchmark_recording.md")
    add("--part", choices=("freerun", "lockstep"), help=argparse.SUPPRESS)
    add("--out", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part is not None:
        measure = {
            "freerun": lambda: side_by_side.measure(
                TASK, ROBOT, CAMERAS, options.seconds, options.out
            ),
            "lockstep": lambda: lockstep(options.out),
        }[options.part]
        options.json.write_text(json.dumps(measure()), "utf-8")
        return 0
    before = os.getloadavg()[0]
    parts = ["freerun", *([] if options.no_lockstep else ["lockstep"])]
    found: dict[str, Any] = {"format": "surg_bench_recording/1", "lockstep": None}
    paths.RUNS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=paths.RUNS, prefix="bench_") as folder:
        for part in parts:
            found[part] = in_process(part, options.seconds, Path(folder))
    found["machine"] = this_machine(before)
    publish(found, recording_page, options)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except CliError as problem:
        sys.exit(f"bench recording: {problem}")
