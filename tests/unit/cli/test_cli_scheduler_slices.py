"""Short turns: inherited by what is started meanwhile, and by nothing else."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from surg_cli.graph import turns
from surg_cli.host import paths

ASK = "from surg_cli.graph import turns; print(turns._attributes().runtime)"


def slice_ns() -> int:
    """Length of the calling thread's slices [ns]; 0: unknown to the kernel."""
    attributes = turns._attributes()
    return int(attributes.runtime) if attributes is not None else 0


def asked() -> int:
    """Turn of a process that is started now [ns]."""
    env = {**os.environ, "PYTHONPATH": str(paths.ROOT / "tools")}
    argv = [sys.executable, "-s", "-c", ASK]
    return int(subprocess.run(argv, env=env, capture_output=True, text=True, check=True).stdout)


def test_what_is_started_meanwhile_has_them() -> None:
    usual, nice = slice_ns(), os.nice(0)
    if not usual:
        pytest.skip("this kernel does not tell the length of a turn (Linux 6.12 does)")
    with turns.short():
        assert slice_ns() == turns.SHORT_NS
        assert asked() == turns.SHORT_NS
        assert os.nice(0) == nice
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert slice_ns() == usual
    assert asked() == usual
    assert usual > 2 * turns.SHORT_NS


def test_an_error_leaves_nothing_behind() -> None:
    usual = slice_ns()
    with pytest.raises(ZeroDivisionError), turns.short():
        raise ZeroDivisionError
    assert slice_ns() == usual


@pytest.mark.parametrize("why", ["an unknown machine", "a refusal"])
def test_where_there_are_none_all_goes_on(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    number = 0 if why == "an unknown machine" else 10**6  # a system call that there is not
    monkeypatch.setattr(turns, "_GET", number)
    entered = False
    with turns.short():
        entered = True
    assert entered
    assert slice_ns() == 0
