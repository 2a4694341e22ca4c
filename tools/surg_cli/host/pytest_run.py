"""Runs pytest with its output shown, and counts what it reports."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence

from surg_cli.host import paths, workspace

MAX_WORKERS = 3
"""One that drives graphs in real time, and those that run the other tests."""


def run(argv: Sequence[str], env: Mapping[str, str], parallel: bool) -> tuple[int, Counter[str]]:
    """Run pytest with its output shown, and count.

    Args:
        argv: The command line.
        env: Its environment.
        parallel: Use pytest-xdist, with as many workers as there are cores for. The tests' conftest
            assigns the groups.

    Returns:
        Exit status, and counts by word such as `passed`.
    """
    workers = min(MAX_WORKERS, workspace.jobs())
    if parallel and workers > 1:
        argv = [*argv, "-n", str(workers), "--dist", "loadgroup"]
        argv += ["--max-worker-restart", "0"]  # a new worker would repeat the test that crashed
    process = subprocess.Popen(
        argv, env=env, cwd=paths.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    tail = b""
    while chunk := os.read(process.stdout.fileno(), 4096):
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
        tail = (tail + chunk)[-20_000:]
    status = process.wait()
    return status, parse_counts(tail.decode(errors="replace"))


def parse_counts(tail: str) -> Counter[str]:
    """Counts in pytest's closing lines.

    Args:
        tail: Its last line is such as `== 3 passed, 1 failed in 0.12s ==`. A test of an extra tier
            whose tool is not there is skipped for a reason that begins with `missing:`.

    Returns:
        Numbers by word, and how many tests are `missing`.
    """
    closing = [line for line in tail.splitlines() if " in " in line]
    found = re.findall(r"(\d+) ([a-z]+)", closing[-1] if closing else "")
    counts = Counter({word: int(number) for number, word in found})
    if missing := re.findall(r"^SKIPPED \[(\d+)\] \S+: missing:", tail, re.MULTILINE):
        counts["missing"] = sum(int(number) for number in missing)
    return counts
