"""Runs pytest: one, or several that share the files (tests/helpers/graph/claims.py)."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import IO

from surg_cli.host import paths, workspace

AT_MOST = 3
"""One that drives graphs in real time, and those that take the rest."""
AFTER_THE_FIRST = ["nice", "-n", "10"]
"""A graph in real time must not wait for a core: the others take what it leaves of them."""


def run(argv: Sequence[str], env: Mapping[str, str], shared: bool) -> tuple[int, Counter[str]]:
    """Run pytest with its output shown, and count.

    Args:
        argv: The command line.
        env: Its environment.
        shared: Several processes share the tests, as many as there are cores for.

    Returns:
        Exit status (0, or that of one which failed), and counts by word such as `passed`.
    """
    workers = min(AT_MOST, workspace.jobs()) if shared else 1
    if workers < 2:
        return _alone(argv, env)
    return _together(argv, env, workers)


def _alone(argv: Sequence[str], env: Mapping[str, str]) -> tuple[int, Counter[str]]:
    """One pytest; what it prints is passed on as it comes."""
    process = subprocess.Popen(
        argv, env=env, cwd=paths.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    tail = b""
    while chunk := os.read(process.stdout.fileno(), 4096):
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
        tail = (tail + chunk)[-4000:]
    status = process.wait()
    return status, parse_counts(tail.decode(errors="replace"))


def _together(
    argv: Sequence[str], env: Mapping[str, str], workers: int
) -> tuple[int, Counter[str]]:
    """Several pytests; a line of one is never torn by another's."""
    counts: Counter[str] = Counter()
    status = 0
    lock = threading.Lock()

    def follow(process: subprocess.Popen[str]) -> None:
        nonlocal status
        assert process.stdout is not None
        closing = "".join(_show_until_closing(process.stdout, lock))
        ended = process.wait()
        with lock:
            sys.stdout.write(closing)
            sys.stdout.flush()
            counts.update(parse_counts(closing))
            status = status or ended

    with tempfile.TemporaryDirectory(prefix="surg_test_") as claims:
        threads = []
        for number in range(workers):
            process = subprocess.Popen(
                [*(AFTER_THE_FIRST if number else ()), *argv, "-o", "console_output_style=classic"],
                env={**env, "SURG_TEST_CLAIMS": claims, "SURG_TEST_WORKER": str(number)},
                cwd=paths.ROOT,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
            threads.append(threading.Thread(target=follow, args=(process,)))
            threads[-1].start()
        for thread in threads:
            thread.join()
    return status, counts


def _show_until_closing(lines: IO[str], lock: threading.Lock) -> Iterable[str]:
    """Show a pytest's lines, one for a file; hand back those behind its last test, as one piece."""
    closing = False
    for line in lines:
        closing = closing or (line.startswith("=") and " test session starts " not in line)
        if closing:
            yield line
            continue
        with lock:
            sys.stdout.write(line)
            sys.stdout.flush()


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
