"""Trains all that the image policy is compared with: each method with several seeds, side by side.

    python3 -m surg_learn.bgr.train_baselines runs/views runs/field

Each training is a `train_cloned.py` of its own on one thread, which writes
`runs/field/METHOD_SEED.npz` and a `.log`. What follows ` -- ` are options of it. The same command
goes on where it was interrupted, and trains what is missing; other options need another folder.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from surg_learn.bgr.cloned_networks import METHODS

TRAINER = Path(__file__).with_name("train_cloned.py")
COST = {"bc": 1.0, "act": 2.0, "moe_act": 2.0}
"""Time of a training, about, in that of the first."""
PERIOD_S = 1.0
"""Between two looks at the trainings."""
NEWS_S = 20.0
"""Between two lines."""
PART = re.compile(r'^{"part": ([0-9.]+),', re.MULTILINE)
"""The share that a line of a training's log says."""


@dataclass
class Training:
    """One of several.

    Attributes:
        command: Runs it.
        out: Its weights, named by method and seed.
        cost: Of `COST`.
    """

    command: list[str]
    out: Path
    cost: float
    process: subprocess.Popen[bytes] | None = None

    @property
    def log(self) -> Path:
        """What it prints: JSON lines."""
        return self.out.with_suffix(".log")

    def start(self) -> None:
        """Run it on one thread."""
        with self.log.open("ab") as log:
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            self.process = subprocess.Popen(self.command, stdout=log, stderr=log, env=environment)

    def done(self) -> float:
        """Share that is done; of a log that cannot be read none."""
        if self.out.exists():
            return 1.0
        try:
            return float(PART.findall(self.log.read_text("utf-8"))[-1])
        except (OSError, IndexError):
            return 0.0

    def said(self) -> str:
        """The last line that it printed."""
        return (self.log.read_text("utf-8").splitlines() or ["nothing"])[-1]


def planned(given: argparse.Namespace, more: Sequence[str]) -> list[Training]:
    """All trainings, seed by seed: what is stopped early has all methods alike."""
    found = []
    for seed in given.seeds:
        for method in given.methods:
            out = given.out / f"{method}_{seed}.npz"
            words = [str(given.data), "--method", method, "--seed", str(seed), "--out", str(out)]
            command = [sys.executable, str(TRAINER), *words, "--json", *more]
            found.append(Training(command, out, COST[method]))
    return found


def run(trainings: Sequence[Training], jobs: int) -> list[Training]:
    """Train what is missing, so many at a time; returns what failed."""
    waiting = [each for each in trainings if not each.out.exists()]
    running, failed = list[Training](), list[Training]()
    started, whole = time.monotonic(), sum(each.cost for each in trainings)
    begun = sum(each.cost * each.done() for each in trainings)
    news = started
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                running.append(waiting.pop(0))
                running[-1].start()
            time.sleep(PERIOD_S)
            for each in [r for r in running if r.process and r.process.poll() is not None]:
                running.remove(each)
                if not each.out.exists():
                    failed.append(each)
            now = time.monotonic()
            if now - news > NEWS_S:
                news = now
                done = sum(each.cost * each.done() for each in trainings)
                left = (now - started) * (whole - done) / (done - begun) if done > begun else None
                when = "" if left is None else f"; {left / 60:.0f} min left"
                names = ", ".join(each.out.stem for each in running)
                print(f"{100 * done / whole:3.0f} % {names}{when}", flush=True)
    finally:
        for each in running:
            if each.process:
                each.process.terminate()
                each.process.wait()
    return failed


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, 2 for unusable words, or 1 if a training failed."""
    parser = argparse.ArgumentParser(
        prog="train_baselines",
        description=(__doc__ or "").split("\n")[0],
        usage="%(prog)s DATA OUT [options] [-- options of train_cloned.py]",
    )
    parser.add_argument("data", type=Path, help="of ./surg episode export, or of cache_pictures.py")
    parser.add_argument("out", type=Path, help="folder for the weights")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    words = sys.argv[1:] if words is None else list(words)
    cut = words.index("--") if "--" in words else len(words)
    given, more = parser.parse_args(words[:cut]), words[cut + 1 :]
    if given.jobs < 1:
        parser.error(f"--jobs {given.jobs}: allowed are 1 and more")
    given.out.mkdir(parents=True, exist_ok=True)
    trainings = planned(given, more)
    for each in trainings:
        if each.out.exists():
            print(f"{each.out} is there already")
    try:
        failed = run(trainings, given.jobs)
    except KeyboardInterrupt:
        print("interrupted: the same command goes on")
        return 130
    for each in trainings:
        if each not in failed:
            print(each.out)
    for each in failed:
        print(f"train_baselines: {each.out.stem}: {each.said()} ({each.log})", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
