"""How a policy's script is started beside the graph."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from surg_cli.graph import policy_program


@pytest.mark.parametrize(("lockstep", "threads"), [(False, "1"), (True, None)])
def test_in_real_time_a_policy_computes_in_one_thread(
    lockstep: bool, threads: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In lock-step time stands still; there its results stay those of all its threads."""
    started: list[dict[str, str]] = []

    def start(name: str, argv: list[str], essential: bool, extra_env: dict[str, str]) -> Any:
        assert (name, essential) == (policy_program.CLIENT, False) and "p.py" in argv
        started.append(extra_env)
        return SimpleNamespace(exit_code=None, log_tail=lambda: "")

    monkeypatch.setattr(policy_program.system, "start", lambda *a: None)
    monkeypatch.setattr(policy_program.system, "model_server", lambda plan: None)
    policy = SimpleNamespace(script="p.py", address="tcp://127.0.0.1:1", keys="")
    plan = SimpleNamespace(policy=policy, lockstep=lockstep)
    watch = SimpleNamespace(policy=SimpleNamespace(waiting=True))
    policy_program.connect(plan, SimpleNamespace(start=start), watch, lambda part, text: None)
    assert [env.get("OPENBLAS_NUM_THREADS") for env in started] == [threads]


def test_a_program_that_ends_without_a_word_is_told_what_it_lacks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended = SimpleNamespace(exit_code=0, log_tail=lambda lines: "")
    monkeypatch.setattr(policy_program.system, "start", lambda *a: None)
    monkeypatch.setattr(policy_program.system, "model_server", lambda plan: None)
    policy = SimpleNamespace(script="p.py", address="tcp://127.0.0.1:1", keys="")
    supervisor = SimpleNamespace(start=lambda *a, **k: ended)
    watch = SimpleNamespace(policy=SimpleNamespace(waiting=False))
    plan = SimpleNamespace(policy=policy, lockstep=True)
    with pytest.raises(policy_program.ProgramDied, match=r"ended \(0\)[^.]*printed nothing.*new"):
        policy_program.connect(plan, supervisor, watch, lambda part, text: None)
