"""A long program with its output in a log file and its progress on the terminal."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from surg_cli.host.environment import clean
from surg_cli.host.terminal import CliError, Progress

TAIL = 15  # lines of a failed program's output that are shown


def run(
    argv: Sequence[str],
    log: Path,
    progress: Progress,
    *,
    anew: bool = False,
    fraction: Callable[[Sequence[str]], float | None] = lambda lines: None,
    failure: Callable[[Sequence[str], Path], str] | None = None,
    env: Mapping[str, str] | None = None,
) -> None:
    """Run a program to its end, in ``env`` or a clean environment and without an input.

    ``fraction`` makes the done part (None: unknown) of the lines so far, ``failure`` the text of
    the problem of all lines and the log; by default the last lines.

    Raises:
        CliError: The program fails.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    with log.open("w" if anew else "a", encoding="utf-8") as stream:
        stream.write("$ " + " ".join(argv) + "\n")
        process = subprocess.Popen(
            argv,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=clean() if env is None else env,
        )
        assert process.stdout is not None
        for line in process.stdout:
            stream.write(line)
            lines.append(line.rstrip())
            progress.update(fraction(lines), line.strip()[:60])
    if process.wait() != 0:
        if failure is not None:
            raise CliError(failure(lines, log))
        tail = "\n".join(lines[-TAIL:])
        raise CliError(f"failed: {' '.join(argv)[:200]}\n{tail}\nThe whole output: {log}")
