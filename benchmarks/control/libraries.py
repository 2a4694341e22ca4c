"""`.venv-bench`: the libraries to compare with, from a pinned lock file, apart from the platform's.

Nothing here touches `.venv`. Without a network, or after a failure, the benchmark runs without
them and says so.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from surg_cli.host import logged, paths
from surg_cli.host.terminal import CliError, Progress, say, warn

VENV = paths.ROOT / ".venv-bench"
LOCK = paths.ROOT / "benchmarks" / "requirements.lock"
LOG = paths.STATE / "logs" / "bench.log"


def run(argv: list[str], title: str) -> None:
    """Run one step with its output in the log.

    Args:
        argv: Program and arguments.
        title: Shown while it runs.

    Raises:
        CliError: When it fails.
    """
    with Progress(title) as progress:
        logged.run(argv, LOG, progress)


def installed() -> Path | None:
    """The site-packages of `.venv-bench`, with the C++ headers; None: they are not there."""
    if not _stamp().exists() or _stamp().read_text("utf-8") != paths.file_digest(LOCK):
        return None
    return next(iter(VENV.glob("lib/python3*/site-packages")), None)


def install() -> Path | None:
    """Make `.venv-bench` and fill it from the lock file, unless that was done before."""
    there = installed()
    if there is not None:
        return there
    say(f"libraries to compare with: {VENV} (log: {LOG})")
    shutil.rmtree(VENV, ignore_errors=True)
    pip = [str(VENV / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install"]
    strict = ["--no-deps", "--require-hashes", "--only-binary", ":all:", "-r", str(LOCK)]
    try:
        run([str(paths.SYSTEM_PYTHON), "-m", "venv", str(VENV)], "make .venv-bench")
        run([*pip, *strict], "install libraries")
    except CliError as problem:
        warn(f"bench: going on without the libraries of others; {problem}")
        return None
    paths.write_text(_stamp(), paths.file_digest(LOCK))
    return installed()


def _stamp() -> Path:
    return VENV / "lock.sha256"
