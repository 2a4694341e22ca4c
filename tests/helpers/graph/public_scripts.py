"""The public scripts of crtk_python_client and dvrk_python, typed into as a person would."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from helpers.graph.public_script_run import HEAD
from surg_cli.host import paths

VARIABLE = "SURG_PUBLIC_CLIENTS"
REPOSITORIES = ("crtk_python_client", "dvrk_python")
ASK = (
    f"missing: check out github.com/collaborative-robotics/crtk_python_client (1.4.0) and "
    f"github.com/jhu-dvrk/dvrk_python (2.4.0) into one folder and name it in {VARIABLE}"
)
RUNNER = paths.ROOT / "tests" / "helpers" / "graph" / "public_script_run.py"

Step = tuple[str, Callable[[], None] | None, str]
"""What the script must have printed, what happens before the answer, and the answer."""


def folder() -> Path:
    """The folder with both checkouts; without it the test is skipped as missing."""
    found = Path(os.environ.get(VARIABLE, "") or "/nonexistent")
    if not all((found / name / "src").is_dir() for name in REPOSITORIES):
        pytest.skip(ASK)
    return found


def path_of(script: str) -> Path:
    """A script of the table; another version of the checkouts may lack it."""
    repository = REPOSITORIES[script.startswith("dvrk_")]
    found = folder() / repository / "scripts" / f"{script}.py"
    if not found.exists():
        pytest.skip(f"missing: {repository} has no scripts/{script}.py in the version checked out")
    return found


@dataclass
class Ended:
    """What a script left.

    Attributes:
        code: Its exit status, negative for a signal.
        text: All that it printed.
        waits: Calls of ``wait()``.
        in_vain: Those that ended at their time-out.
        longest: The longest of them [s].
    """

    code: int
    text: str
    waits: int = 0
    in_vain: int = 0
    longest: float = 0.0


@dataclass
class Script:
    """A running script at a terminal of its own.

    Args:
        name: Of the script, without ``.py``.
        words: Its arguments.
        env: Of the graph.
        python: That runs it; rclpy has one of its own.
    """

    name: str
    words: Sequence[str]
    env: dict[str, str]
    python: Path = Path(sys.executable)
    _data: bytearray = field(default_factory=bytearray, init=False)

    def __post_init__(self) -> None:
        sources = [str(folder() / name / "src") for name in REPOSITORIES]
        python_path = ":".join([*sources, self.env.get("PYTHONPATH", "")])
        self._terminal, ours = pty.openpty()
        self._process = subprocess.Popen(
            [str(self.python), str(RUNNER), str(path_of(self.name)), *self.words],
            env={**self.env, "PYTHONPATH": python_path, "PYTHONUNBUFFERED": "1"},
            stdin=ours,
            stdout=ours,
            stderr=ours,
            start_new_session=True,
        )
        os.close(ours)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the other end is closed
            while data := os.read(self._terminal, 65536):
                self._data += data

    @property
    def text(self) -> str:
        """All that it has printed."""
        return self._data.decode(errors="replace").replace("\r\n", "\n")

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def talk(self, steps: Sequence[Step], timeout: float = 60.0) -> None:
        """Answer what it asks; a script that has ended is not asked for more."""
        after = 0
        for awaited, act, answer in steps:
            end = time.monotonic() + timeout
            while (found := self.text.find(awaited, after)) < 0:
                if not self.running:
                    return
                assert time.monotonic() < end, f"waited for {awaited!r}:\n{self.text}"
                time.sleep(0.05)
            after = found + len(awaited)
            if act is not None:
                act()
            os.write(self._terminal, answer.encode())

    def end(self, timeout: float = 90.0) -> Ended:
        """Wait for its end.

        Raises:
            AssertionError: It runs on; it is ended then.
        """
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f"{self.name} runs after {timeout} s:\n{self.text}") from None
        self._reader.join(2.0)
        os.close(self._terminal)
        head, _, found = self.text.rpartition(HEAD)
        counts = json.loads(found.splitlines()[0]) if found else {}
        return Ended(self._process.returncode, head or self.text, **counts)

    def stop(self) -> Ended:
        """End it as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        return self.end(20.0)

    def kill(self) -> None:
        """End it whatever it does."""
        if self.running:
            self._process.kill()
            self._process.wait()
