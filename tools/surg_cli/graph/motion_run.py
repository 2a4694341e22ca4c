"""Plays a recorded motion through the whole graph, and follows it to its end."""

from __future__ import annotations

import os
import time

from surg_cli.graph import follow, master, processes, running, system
from surg_cli.graph.system import Plan
from surg_cli.graph.watch import Watch
from surg_cli.host import environment
from surg_cli.host.terminal import Progress

OPERATOR_TIMEOUT_S = 15.0
AROUND_MOTION_S = 2.5
"""[s] Homing, the way to the start, settling and the last hold; for the progress line only."""


def play(plan: Plan, duration_s: float, port: int | None) -> list[str]:
    """Run a plan with an operator to its end.

    Args:
        plan: What to start; its folder receives `episode/` and `logs/`.
        duration_s: Length of the motion, for the progress line.
        port: Of the master, None for a free one.

    Returns:
        Why the run failed, one sentence each; empty when it came to its end.

    Raises:
        Problem: When the system does not come up, or nothing was recorded.
    """
    env = environment.for_nodes(ros_home=plan.out / "logs" / "ros")
    with processes.orphans_adopted(), processes.Supervisor(env, plan.out / "logs") as supervisor:
        return _supervise(plan, duration_s, port, supervisor)


def _supervise(
    plan: Plan, duration_s: float, port: int | None, supervisor: processes.Supervisor
) -> list[str]:
    """Start the master, list the system as running, follow it."""
    port = port or master.free_port()
    master.start(supervisor, port)
    with running.announced("demo", port, plan.cell, supervisor.logs) as entry:
        return _follow(plan, duration_s, supervisor, entry)


def _follow(
    plan: Plan, duration_s: float, supervisor: processes.Supervisor, entry: running.System
) -> list[str]:
    """Start the nodes and watch them until the motion is over."""
    for node in system.nodes(plan):
        system.start(supervisor, node)
    os.environ.update(supervisor.env)
    reasons: list[str] = []
    with Watch(plan.arms) as watch, Progress("demo") as progress:
        watch.record(True)
        follow.wait_for(
            lambda: watch.recording is True, supervisor, progress.update, "the recorder"
        )
        operator = system.start(supervisor, system.operator_node(plan))
        entry.list_nodes(supervisor.children)
        fault_at: float | None = None
        while (sim := watch.sim).state != sim.STATE_DONE and operator.exit_code != 0:
            time.sleep(0.05)
            seconds = sim.sim_time
            note = " ".join(f"{name} {state}" for name, state in watch.states.items())
            fraction = seconds / (duration_s + AROUND_MOTION_S)
            progress.update(fraction, f"{seconds:5.1f} s simulated, {note}")
            if watch.faulted and fault_at is None:
                fault_at = time.monotonic()
            reasons = follow.failure(watch, supervisor, fault_at, (f"/{system.OPERATOR}",))
            if reasons:
                break
        progress.update(1.0, "writing the recording")
        if not reasons:
            reasons = _operator_verdict(operator)
        reasons += follow.finish_recording(watch, supervisor)
    return reasons


def _operator_verdict(operator: processes.Child) -> list[str]:
    """What the operator says at its end; empty when it has played the whole motion."""
    if not processes.wait_until(lambda: operator.exit_code is not None, OPERATOR_TIMEOUT_S):
        return ["the operator did not end"]
    return [] if operator.exit_code == 0 else [follow.death_notice(operator)]
