"""Runs pytest with its output shown, and counts what it reports."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence

from surg_cli.host import paths, workspace
from surg_cli.host.terminal import say

GROUP = re.compile(r"@[\w-]+(?: - .*)?$")
"""What pytest-xdist appends to a test's id: its group; then pytest's reason."""
MAX_WORKERS = 3
"""One that drives graphs in real time, and those that run the other tests."""
MAX_REPEATED = 8
"""Tests that may be repeated; more failures are not the machine's."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Threads of a matrix product: beside other workers more of them spin for a core."""

HANGS_S = 300
"""A test of the whole run that takes longer hangs. The slowest takes a fifth of it."""


def run(
    argv: Sequence[str], tests: Sequence[str], env: Mapping[str, str], parallel: bool
) -> tuple[int, Counter[str]]:
    """Run pytest with its output shown, and count.

    Beside other tests, whatever waits for a process or a thread can miss a core. If a few tests
    fail, they run once more, alone, and that run decides. The output has both reports.

    Args:
        argv: The command line without the tests.
        tests: Files, folders or ids.
        env: Its environment.
        parallel: Use pytest-xdist, with as many workers as there are cores for. The tests' conftest
            assigns the groups.

    Returns:
        Exit status, and counts by word such as `passed`.
    """
    # The worker in real time mostly waits, and is preferred: the others share what it leaves.
    cores = workspace.jobs()
    workers = min(MAX_WORKERS, cores + 1)
    if not parallel or cores < 2:
        status, tail = _run([*argv, *tests], env)
        return status, parse_counts(tail)
    groups = ["-n", str(workers), "--dist", "loadgroup"]
    groups += ["--max-worker-restart", "0"]  # a new worker would repeat the test that crashed
    ends = ["--timeout", str(HANGS_S)]
    status, tail = _run([*argv, *tests, *groups, *ends], {**env, **ONE_THREAD})
    counts = parse_counts(tail)
    failed = failed_tests(tail)
    if status == 1 and 0 < len(failed) <= MAX_REPEATED:
        say(f"{len(failed)} tests failed beside others; once more, alone:")
        status, tail = _run([*argv, *failed, *ends], env)
        again = parse_counts(tail)
        counts.update(again)
        counts["failed"], counts["error"], counts["errors"] = (
            again[word] for word in ("failed", "error", "errors")
        )
    return status, counts


def _run(argv: Sequence[str], env: Mapping[str, str]) -> tuple[int, str]:
    """Exit status, and the end of the output."""
    process = subprocess.Popen(
        argv, env=env, cwd=paths.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    tail = b""
    while chunk := os.read(process.stdout.fileno(), 4096):
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
        tail = (tail + chunk)[-20_000:]
    return process.wait(), tail.decode(errors="replace")


def failed_tests(tail: str) -> list[str]:
    """Ids of the failed tests, without their groups; none if a worker crashed."""
    if re.search("worker '.*' crashed", tail):
        return []
    lines = re.findall(r"^(?:FAILED|ERROR) (.+)$", tail, re.MULTILINE)
    return list(dict.fromkeys(GROUP.sub("", line) for line in lines))


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
