"""Runs one episode in a process of its own, see `task_episode`, and reads how it ended."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from surg_cli.graph import processes, task_episode
from surg_cli.graph.system_plan import SystemPlan

EPISODE_TIMEOUT_S = 1800.0
"""[s] wall clock: longest an episode may take, start and report included."""


def run_episode(plan: SystemPlan, show: Callable[[float, str], None]) -> task_episode.Ended:
    """Play one episode; ``show`` gets the simulated time [s] and a note on the progress.

    If the process leaves no outcome, the end of its log is the reason.
    """
    task_episode.write_plan(plan)
    return read_outcome(plan.out, run_process(plan.out, show))


def read_outcome(folder: Path, error: str) -> task_episode.Ended:
    """How an episode ended; ``error`` is the reason if its process left no outcome."""
    file = folder / task_episode.OUTCOME
    if file.exists():
        return task_episode.Ended(**json.loads(file.read_text("utf-8")))
    return task_episode.Ended(False, error, "", 0.0, False, None)


def run_process(folder: Path, show: Callable[[float, str], None]) -> str:
    """Run the process of the plan in a folder; returns the end of its log if it failed."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    argv = [sys.executable, "-s", "-m", "surg_cli.graph.task_episode", str(folder)]
    with processes.Supervisor(env, folder / "logs") as supervisor:
        child = supervisor.start("episode", argv)
        give_up = time.monotonic() + EPISODE_TIMEOUT_S
        while child.exit_code is None and time.monotonic() < give_up:
            time.sleep(0.1)
            if news := progress(child.log_tail(1)):
                show(*news)
    if child.exit_code == 0:
        return ""
    lines = [line for line in child.log_tail(20).splitlines() if not line.startswith('{"seconds"')]
    return "\n".join(lines) or f"the episode's process ended with {child.exit_code}"


def progress(line: str) -> tuple[float, str] | None:
    """Simulated time [s] and note of the last line of an episode's log.

    None: it is another line, or has been written in part only.
    """
    try:
        news = json.loads(line)
        return float(news["seconds"]), str(news["note"])
    except (ValueError, TypeError, KeyError):
        return None


def describe(plan: SystemPlan, ended: task_episode.Ended) -> dict[str, Any]:
    """The entry of an episode in the summary; writes its report beside its recording."""
    from surg_recording.reports import run_report

    entry, _ = measure(plan, ended, lambda _, recorded: recorded and run_report.make(plan.out))
    entry["real_time_factor"] = ended.real_time_factor
    if plan.policy is not None:
        entry["policy"] = ended.policy
    entry["folder"] = f"episodes/{plan.out.name}"
    return entry


def measure(
    plan: SystemPlan, ended: task_episode.Ended, also: Callable[[dict[str, Any], Any], Any]
) -> tuple[dict[str, Any], Any]:
    """The entry of an episode by `trials.describe`, and the result of ``also(entry, recording)``.

    A recording that cannot be read is None, and the episode was not played.
    """
    from surg_recording.episode import episode_reader
    from surg_recording.episode.verdicts import ABORTED
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.reports import trials

    def entry(outcome: trials.TrialOutcome, recorded: Any) -> tuple[dict[str, Any], Any]:
        made = trials.describe(plan.seed, plan.setting, plan.law, outcome, recorded)
        counts = ended.policy or {}
        if counts.get("waited") or counts.get("sessions", 1) > 1:
            made["deterministic"] = False  # ticks ran without the policy: this machine was too slow
        return made, also(made, recorded)

    success = ended.success if ended.played else None
    outcome = trials.TrialOutcome(
        success, ended.reason, ended.phase, ended.duration_s, ended.played, ended.outcome
    )
    try:
        return entry(outcome, episode_reader.read(plan.out / "episode"))
    except EpisodeError as error:
        unreadable = str(error) if (plan.out / "episode").exists() else ""
        reason = "; ".join(filter(None, (ended.reason, unreadable))) or str(error)
        broken = replace(outcome, played=False, success=None, reason=reason)
        return entry(replace(broken, outcome=ended.outcome if not ended.played else ABORTED), None)
