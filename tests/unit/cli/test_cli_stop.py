"""`./surg stop` pauses first: it sets nothing up and builds nothing, whatever has changed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from surg_cli import __main__ as entry
from surg_cli.graph import processes, running
from surg_cli.host import paths, provision, workspace

LISTENER = """
import signal
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})  # kept until it is waited for
print("listens", flush=True)
signal.sigwait({signal.SIGUSR1})
print("paused", flush=True)
"""


def test_stop_signals_before_anything_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(entry.READY, raising=False)
    monkeypatch.setattr(paths, "SYSTEMS", tmp_path)
    for module, name in ((provision, "make_ready"), (workspace, "build")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("sets up or builds"))
    entered: list[str] = []
    monkeypatch.setattr(entry, "_enter_workspace", lambda name, words: entered.append(name))
    monkeypatch.setattr(entry, "parse", lambda name, words: (None, lambda *_: 0))
    with subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE) as system:
        assert system.stdout is not None and system.stdout.readline() == b"listens\n"
        since = processes.start_time(system.pid) or 0
        running.System(45997, system.pid, since, "up", str(tmp_path), str(tmp_path)).save()
        assert entry.run(["stop", "--port", "45997"]) == 0
        assert system.stdout.readline() == b"paused\n"
    assert entered == ["stop"] and os.listdir(tmp_path)


def test_the_script_signals_before_it_starts_any_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine each program that it starts delays the stop."""
    monkeypatch.setattr(paths, "SYSTEMS", tmp_path / ".surg" / "run")
    script = tmp_path / "surg"
    script.write_bytes((paths.ROOT / "surg").read_bytes())
    with subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE) as system:
        assert system.stdout is not None and system.stdout.readline() == b"listens\n"
        since = processes.start_time(system.pid) or 0
        running.System(45997, system.pid, since, "up", str(tmp_path), str(tmp_path)).save()
        found_none = {"PATH": "/nonexistent"}
        subprocess.run(["/bin/sh", script, "stop"], env=found_none, stderr=subprocess.DEVNULL)
        try:
            assert system.wait(5.0) == 0 and system.stdout.readline() == b"paused\n"
        finally:
            system.kill()
