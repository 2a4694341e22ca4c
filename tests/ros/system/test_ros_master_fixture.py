"""Processes of a system end with their supervisor, also after a kill."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from surg_cli.graph import processes
from surg_cli.graph.processes import Supervisor
from surg_cli.host import paths

pytestmark = pytest.mark.ros


def test_children_end_with_their_supervisor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = [(number, min(grace, 0.3)) for number, grace in processes.STAGES[:-1]]
    monkeypatch.setattr(processes, "STAGES", (*quick, processes.STAGES[-1]))
    script = "trap '' INT TERM; sleep 600 & wait; sleep 600"
    with Supervisor(dict(os.environ), tmp_path) as supervisor:
        child = supervisor.start("stubborn", ["/bin/sh", "-c", script])
        assert processes.wait_until(
            lambda: len(processes.session_members(child.process.pid)) == 2, 5.0
        )
    assert processes.session_members(child.process.pid) == []


def test_children_die_with_a_killed_parent(tmp_path: Path) -> None:
    code = (
        "import os, sys, time, pathlib\n"
        "from surg_cli.graph.processes import Supervisor\n"
        "s = Supervisor(dict(os.environ), pathlib.Path(sys.argv[1]))\n"
        "print(s.start('x', ['/bin/sleep', '600']).process.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(paths.ROOT / "tools")}
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True, env=env
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        # The death signal is armed by the wrapper before it becomes `sleep`.
        time.sleep(0.2)
        assert processes.start_time(pid) is not None
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    assert processes.wait_until(lambda: processes.start_time(pid) is None, 5.0)
