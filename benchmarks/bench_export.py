"""Exported frames per second beside lerobot's own writer, with the same codec and settings.

`--json FILE` writes:

    format       "surg_bench_export/1"
    machine      {processor, cores, load_before, load_after, date}
    rounds       how often each writer wrote, one after the other in turns
    rows         [{writer, frames, wall_s, cpu_s, memory_mib}], one per writer and round; memory is
                 the peak of all processes of the writer together, shared libraries counted in each
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import export_page
import numpy as np
from machine import this_machine
from publish import publish

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress, warn

sys.path.insert(0, str(paths.ROOT / "tests"))
from helpers.machines.peak_memory import watched
from helpers.recording import datasets_synthetic
from helpers.recording.picture_identity import Identity
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

LEROBOT = "0.4.4"
LONGEST_S = 600
"""Of one turn of a writer; it takes about 30 s."""
THEIRS = f"lerobot {LEROBOT}, crf 30, preset medium"
SAME = {"crf": 30, "preset": "medium"}
"""As lerobot encodes: x264's default preset; a key frame every second frame is the default."""
OURS: dict[str, dict[str, Any]] = {
    "ours, one process, crf 30, preset medium": {"executor": "serial", **SAME},
    "ours, two processes, crf 30, preset medium": {"executor": "process", "workers": 2, **SAME},
    "ours, two processes, the defaults (crf 18, veryfast)": {"executor": "process", "workers": 2},
}


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="./surg dev bench export", description=(__doc__ or "")[:95]
    )
    add = parser.add_argument
    add("episodes", nargs="*", type=Path, help="recordings (default: made up, with texture)")
    add("--seconds", type=float, default=10.0, metavar="S", help="of each made-up recording")
    add("--recordings", type=int, default=2, metavar="N", help="made-up recordings (default 2)")
    add("--rounds", type=int, default=3, metavar="N", help="turns of every writer (default 3)")
    add("--json", type=Path, metavar="FILE", help="the figures")
    add("--page", action="store_true", help="renew docs/results/benchmark_export.md")
    add("--writer", choices=tuple(OURS), help=argparse.SUPPRESS)
    add("--out", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.writer is not None:
        print(json.dumps(written(options.episodes, options.out, OURS[options.writer])))
        return 0
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        recordings = options.episodes or made_up(root, options.recordings, options.seconds)
        rows = in_turns(root, recordings, options.rounds)
    found = {"format": "surg_bench_export/1", "rounds": options.rounds, "rows": rows}
    publish({**found, "machine": this_machine(before)}, export_page, options)
    return 0


def in_turns(root: Path, recordings: list[Path], rounds: int) -> list[dict[str, Any]]:
    """Every writer once per round, so that what else the machine does meets all of them."""
    writers = [*OURS, THEIRS]
    if not lerobot_python().exists():
        folder = lerobot_python().parents[1].name
        warn(f"no {folder}: lerobot is not measured (./surg test --tier oracle makes it)")
        writers.remove(THEIRS)
    rows = []
    with Progress("exporting") as progress:
        for turn in range(rounds * len(writers)):
            writer = writers[turn % len(writers)]
            progress.update(turn / (rounds * len(writers)), writer)
            try:
                found = run(root, writer, root / f"set{turn}", recordings)
            except subprocess.TimeoutExpired:
                # lerobot forks its encoders beside threads, and then they may wait for ever.
                warn(f"{writer} did not end within {LONGEST_S} s; this turn does not count")
                continue
            rows.append({"writer": writer, **found})
    return rows


def run(root: Path, writer: str, out: Path, recordings: list[Path]) -> dict[str, Any]:
    """One writer in a process of its own: frames, wall and processor time, memory."""
    env = dict(os.environ)
    if writer == THEIRS:
        env.pop("PYTHONPATH", None)
        env.update(HF_HUB_OFFLINE="1", HF_HOME=str(root / "hf"))
        script = str(paths.ROOT / "benchmarks" / "lerobot_writer.py")
        argv = [str(lerobot_python()), script, str(out), str(ExportOptions().fps)]
    else:
        argv = [sys.executable, __file__, "--writer", writer, "--out", str(out)]
    argv += map(str, recordings)
    pipe = subprocess.PIPE
    with (
        subprocess.Popen(
            argv, env=env, stdout=pipe, stderr=pipe, text=True, start_new_session=True
        ) as process,
        watched(process.pid) as peak,
    ):
        try:
            said, errors = process.communicate(timeout=LONGEST_S)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode != 0:
        raise CliError(f"{writer} failed:\n{errors[-2000:]}")
    found = json.loads(said.splitlines()[-1])
    assert isinstance(found, dict)
    return {**found, "memory_mib": peak.total}


def lerobot_python() -> Path:
    """The interpreter of lerobot's environment, there or not."""
    return paths.ROOT / f".venv-oracle-lerobot-{LEROBOT}" / "bin" / "python"


def written(recordings: list[Path], out: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Our export of the recordings, in time; imports are not in it, as with lerobot."""
    chosen = ExportOptions(splits={"train": 1.0}, **settings)
    started, used = time.monotonic(), _cpu()
    report = datasets.load("lerobot_v30").write(recordings, out, chosen)
    wall, cpu = time.monotonic() - started, _cpu() - used
    if not report.ok:
        sys.exit(f"the export failed: {report.errors or report.refused}")
    return {"frames": report.frames, "wall_s": wall, "cpu_s": cpu}


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
            # Not of equal length: equal tables would be one recording given twice.
            length = seconds + 0.1 * number
            made.append(
                datasets_synthetic.record(folder, number, length, size=(640, 480), picture=picture)
            )
    return made


def _cpu() -> float:
    """Processor time of this process and its ended children [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(t.ru_utime + t.ru_stime for t in used)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except CliError as problem:
        sys.exit(f"bench export: {problem}")
