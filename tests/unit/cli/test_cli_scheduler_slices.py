"""Short turns and niceness: inherited by what is started meanwhile, and by nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from surg_cli.graph import scheduler_slices
from surg_cli.host import paths

NICE = """
import os, pathlib, tempfile
from surg_cli.graph.processes import Supervisor
os.nice(7)
with Supervisor(dict(os.environ), pathlib.Path(tempfile.mkdtemp())) as supervisor:
    child = supervisor.start("child", ["/bin/sleep", "30"])
    print(pathlib.Path(f"/proc/{child.process.pid}/autogroup").read_text())
"""
ASK = "from surg_cli.graph import scheduler_slices; print(scheduler_slices._attributes().runtime)"


def slice_ns() -> int:
    """Length of the calling thread's slices [ns]; 0: unknown to the kernel."""
    attributes = scheduler_slices._attributes()
    return int(attributes.runtime) if attributes is not None else 0


def asked(program: str = ASK) -> str:
    """What a program prints: by default its turn [ns]."""
    env = {**os.environ, "PYTHONPATH": str(paths.ROOT / "tools")}
    argv = [sys.executable, "-s", "-c", program]
    return subprocess.run(argv, env=env, capture_output=True, text=True, check=True).stdout


def test_what_is_started_meanwhile_has_them() -> None:
    usual, nice = slice_ns(), os.nice(0)
    if not usual:
        pytest.skip("this kernel does not tell the length of a turn (Linux 6.12 does)")
    with scheduler_slices.short():
        assert slice_ns() == scheduler_slices.SHORT_NS
        assert int(asked()) == scheduler_slices.SHORT_NS
        assert os.nice(0) == nice
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert slice_ns() == usual
    assert int(asked()) == usual
    assert usual > 2 * scheduler_slices.SHORT_NS


def test_an_error_leaves_nothing_behind() -> None:
    usual = slice_ns()
    with pytest.raises(ZeroDivisionError), scheduler_slices.short():
        raise ZeroDivisionError
    assert slice_ns() == usual


@pytest.mark.parametrize("why", ["an unknown machine", "a refusal"])
def test_where_there_are_none_all_goes_on(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    number = 0 if why == "an unknown machine" else 10**6  # a system call that there is not
    monkeypatch.setattr(scheduler_slices, "_GET", number)
    entered = False
    with scheduler_slices.short():
        entered = True
    assert entered
    assert slice_ns() == 0


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="no scheduling by session")
def test_a_session_has_the_niceness_of_who_started_it() -> None:
    assert int(asked(NICE).split()[-1]) == min(19, os.nice(0) + 7)
