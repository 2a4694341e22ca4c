"""Runs `./surg` commands from tests, in the environment `./surg test` has made ready."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from surg_cli import command_table
from surg_cli.host import paths

STOPS_S = 30.0
"""Longest time a command may take to stop its nodes."""


def environment() -> dict[str, str]:
    """Environment of a command: ready, so that it neither installs nor builds."""
    env = {**os.environ, "SURG_READY": "1"}
    env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{env.get('PYTHONPATH', '')}".rstrip(":")
    return env


def parsed(name: str, *words: object) -> argparse.Namespace:
    """The options of a command."""
    return command_table.parse(name, list(map(str, words)))[0]


def called(name: str, *words: object) -> int:
    """A command in this process; its exit status."""
    options, main = command_table.parse(name, list(map(str, words)))
    return main(options, name.split()[-1])


def printed(capsys: pytest.CaptureFixture[str], *words: object) -> list[str]:
    """The lines of `./surg up WORDS --print`, one for each node."""
    assert called("up", *words, "--print") == 0
    return capsys.readouterr().out.splitlines()


def argv(*words: object) -> list[str]:
    """Command line of `./surg WORDS`."""
    return [sys.executable, "-s", "-m", "surg_cli", *map(str, words)]


def argv_with(module: str, name: str, value: object, *words: object) -> list[str]:
    """Command line of `./surg WORDS` with another value of a module's constant."""
    program = (
        "import importlib, sys\nfrom pathlib import PosixPath\n"
        f"setattr(importlib.import_module({module!r}), {name!r}, {value!r})\n"
        "from surg_cli.__main__ import main\nsys.exit(main())\n"
    )
    return [sys.executable, "-s", "-c", program, *map(str, words)]


def surg(
    *words: object,
    timeout_s: float = 300.0,
    extra: dict[str, str] | None = None,
    cwd: Path = paths.ROOT,
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end.

    Args:
        *words: Behind `./surg`.
        timeout_s: Longest time it may take.
        extra: Environment variables on top of `environment()`.
        cwd: Where it is called.

    Returns:
        The ended process with its output.
    """
    return subprocess.run(
        argv(*words),
        env={**environment(), **(extra or {})},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


class Started(subprocess.Popen[bytes]):
    """A running command. A `with` block that fails ends it, instead of waiting for it forever."""

    def __exit__(self, kind, error, trace) -> None:  # type: ignore[no-untyped-def]
        if kind is not None and self.poll() is None:
            self.send_signal(signal.SIGINT)
            try:
                self.wait(STOPS_S)
            except subprocess.TimeoutExpired:
                self.kill()
        super().__exit__(kind, error, trace)


def start(log: Path, *words: object, typed: bool = False) -> Started:
    """Start a command and return at once.

    Args:
        log: File for its output.
        *words: Behind `./surg`.
        typed: Whether the test types into it.
    """
    with log.open("wb") as stream:
        return Started(
            argv(*words),
            env=environment(),
            cwd=paths.ROOT,
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.PIPE if typed else subprocess.DEVNULL,
            start_new_session=True,
        )
