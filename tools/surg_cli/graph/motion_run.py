"""Plays a recorded motion through the whole graph, and follows it to its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from surg_cli.graph import follow, processes, running, system
from surg_cli.graph.system_plan import OPERATOR, SystemPlan
from surg_cli.graph.watch import Watch
from surg_cli.host.terminal import Progress

OPERATOR_TIMEOUT_S = 15.0
AROUND_MOTION_S = 2.5
"""[s] Homing, the way to the start, settling and the last hold; for the progress line only."""


class Robots(Protocol):
    """Robots that a run brings along."""

    def start(self, supervisor: processes.Supervisor) -> None:
        """Start them, before the nodes."""

    def obey(
        self, supervisor: processes.Supervisor, update: Callable[[float | None, str], None]
    ) -> None:
        """Let them obey, once the nodes run."""

    def ask_again(self) -> None:
        """The same for one that has stopped since; before any arm is homed."""


def play(plan: SystemPlan, duration_s: float, robots: Robots) -> list[str]:
    """Run a plan with an operator to its end.

    Returns why the run failed, one sentence each.

    Raises:
        CliError: The system does not come up.
    """
    with running.launched("demo", plan.cell, plan.out) as (supervisor, entry):
        robots.start(supervisor)
        for node in system.nodes(plan):
            system.start(supervisor, node)
        with Watch(plan.arms) as watch, Progress("demo") as progress:
            follow.start_recording(watch, supervisor, progress.update)
            robots.obey(supervisor, progress.update)
            operator = system.start(supervisor, system.operator_node(plan))
            entry.list_nodes(supervisor.children)
            reasons = _follow(
                watch, supervisor, operator, progress, duration_s, plan.simulates, robots
            )
            reasons += _last_complaint(watch, reasons) if reasons else []
            progress.update(1.0, "writing the recording")
            return reasons + follow.finish_recording(watch, supervisor)


def _follow(
    watch: Watch,
    supervisor: processes.Supervisor,
    operator: processes.Child,
    progress: Progress,
    duration_s: float,
    simulates: bool,
    robots: Robots,
) -> list[str]:
    """Wait until the motion is over; returns why the run failed."""
    began, untouched = time.monotonic(), True
    while (sim := watch.sim).state != sim.STATE_DONE and operator.exit_code != 0:
        time.sleep(follow.LOOK_S)
        states = " ".join(f"{name} {state}" for name, state in watch.states.items())
        passed = sim.sim_time if simulates else time.monotonic() - began
        progress.update(
            passed / (duration_s + AROUND_MOTION_S),
            f"{passed:5.1f} s{' simulated' if simulates else ''}, {states}",
        )
        untouched = untouched and set(watch.states.values()) <= {"DISABLED"}
        if untouched:
            robots.ask_again()
        reasons = follow.failure(watch, supervisor, (f"/{OPERATOR}",), simulates)
        if reasons := reasons or ([watch.fault] if watch.fault else []):
            return reasons
    return _operator_verdict(operator)


def _last_complaint(watch: Watch, reasons: list[str]) -> list[str]:
    """What an arm said last of why it does not obey; empty where a reason quotes it already."""
    last = [text for _, text in watch.news()][-1:]
    return [text for text in last if not any(text in reason for reason in reasons)]


def _operator_verdict(operator: processes.Child) -> list[str]:
    """What the operator says at its end; empty when it has played the whole motion."""
    if not processes.wait_until(lambda: operator.exit_code is not None, OPERATOR_TIMEOUT_S):
        return ["the operator did not end"]
    return [] if operator.exit_code == 0 else [follow.death_notice(operator)]
