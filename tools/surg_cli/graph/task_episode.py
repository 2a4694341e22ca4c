"""One episode of a task in a graph of its own: `python -m surg_cli.graph.task_episode FOLDER`.

A process of its own, because a process can be a node of one ROS master only. It reads `plan.json`
in its folder, starts the graph, follows it to the end and writes `outcome.json`. On standard output
it prints a JSON object per line on how far it is.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from surg_cli.graph import follow, policy_program, processes, running, system
from surg_cli.graph.system_plan import Policy, SystemPlan
from surg_cli.graph.watch import Watch
from surg_cli.host import paths
from surg_cli.host.terminal import CliError, warn
from surg_core.status_check import value_name
from surg_recording.episode import verdicts

PLAN, OUTCOME = "plan.json", "outcome.json"
WARM_UP_S = 0.5
"""[s simulated] The rate is measured from here on."""
LEFT_AFTER_END_S = 0.3
"""[s] Longest time from the end of an episode until it is known here."""
AS_SENT = (
    *("waiting", "client", "policy", "episode", "queue", "accepted", "clipped", "rejected"),
    *("late", "stale", "empty", "waited", "messages", "flooded", "strangers", "sessions"),
    *("refused", "warning", "address"),
)
"""Fields of a PolicyStatus that are kept under their own names."""


@dataclass(frozen=True)
class Ended:
    """How an episode ended."""

    success: bool  # the task says so
    reason: str  # why it was none
    phase: str  # of the task, at the end
    duration_s: float  # simulated time
    played: bool  # it came to an end of its own, and all of it is recorded
    # simulated by wall time without start and end; None for a very short one
    real_time_factor: float | None
    # the last `/policy/status` as `policy_record`; None without one
    policy: dict[str, Any] | None = None
    outcome: str = verdicts.ABORTED  # as `verdicts` defines it
    warning: str = ""  # of the gateway to ROS 2, if it has failed


def write_plan(plan: SystemPlan) -> None:
    """Put a plan into its folder for the process that plays it."""
    paths.write_text(plan.out / PLAN, json.dumps(asdict(plan), default=str, indent=1) + "\n")


def read_plan(folder: Path) -> SystemPlan:
    """The plan in a folder."""
    values = json.loads((folder / PLAN).read_text("utf-8"))
    tuples = ("arms", "cameras", "driven", "extra_participants", "record_topics", "record_cameras")
    for name in (*tuples, "sensed", "turned"):
        values[name] = tuple(values[name])
    values["senders"] = {name: tuple(arms) for name, arms in values["senders"].items()}
    for name in ("cell", "out"):
        values[name] = Path(values[name])
    if values["policy"] is not None:
        values["policy"] = Policy(**values["policy"])
    return SystemPlan(**values)


def play(plan: SystemPlan) -> Ended:
    """Bring the plan's graph up, follow the episode to its end, take the graph down.

    Raises:
        CliError: The graph does not come up.
    """
    with running.launched("run", plan.cell, plan.out) as (supervisor, entry):
        senders = [name for name in plan.senders if name != system.POLICY]
        with Watch(plan.arms, senders=senders) as watch:
            if plan.policy is not None:
                policy_program.connect(plan, supervisor, watch, _progress)
            watch.begin()
            for node in [*system.nodes(plan), *system.senders(plan)]:
                system.start(supervisor, node)
            entry.list_nodes(supervisor.children)
            ended = _follow(plan, supervisor, watch)
            gateways = [each for each in supervisor.children if each.name == system.GATEWAY]
            return replace(ended, warning="".join(map(follow.failed_alone, gateways)))


def _follow(plan: SystemPlan, supervisor: processes.Supervisor, watch: Watch) -> Ended:
    """Watch the episode until it is over or must end."""
    follow.start_recording(watch, supervisor, _progress)
    broken: list[str] = []
    crashed: list[str] = []
    fault = ""
    rate = _Rate()
    while (sim := watch.sim).state != sim.STATE_DONE and not broken and not crashed:
        time.sleep(0.02)
        rate.look(sim.sim_time)
        _progress(sim.sim_time, sim.task.phase)
        if fault := watch.fault:
            break
        broken = follow.failure(watch, supervisor)
        if plan.policy is not None:
            crashed = policy_program.crash(supervisor, watch)
    if crashed:  # or has it left after the end, which is not known here yet?
        processes.wait_until(lambda: watch.sim.state == sim.STATE_DONE, LEFT_AFTER_END_S)
    sim = watch.sim
    rate.look(sim.sim_time)
    task = sim.task
    success = task.state == task.STATE_SUCCESS
    over = success or task.state == task.STATE_FAILURE
    crashed = [] if over else crashed
    reason = fault or task.detail
    if not fault and not over:
        reason = "" if crashed else "the simulation ended before the task did"
    gave_up = [f"{name}: {why}" for name, why in watch.gave_up.items()]
    if plan.policy is not None and not success and not crashed:
        gave_up += policy_program.complaints(watch)
    if not over:  # else the task has judged
        word = verdicts.CRASHED if crashed else verdicts.ABORTED
        word = verdicts.FAILURE if fault else word
        said = "; ".join(filter(None, [*crashed, *broken, reason]))
        watch.tell_recorder(json.dumps({"outcome": {"outcome": word, "reason": said}}))
    broken += follow.finish_recording(watch, supervisor)
    played = not broken and not crashed and (bool(fault) or over)
    word = verdicts.CRASHED if crashed else verdicts.ABORTED
    if played:
        word = verdicts.SUCCESS if success and not fault else verdicts.FAILURE
    return Ended(
        success=word == verdicts.SUCCESS,
        reason="; ".join(filter(None, [*crashed, *broken, reason, *gave_up])),
        phase=task.phase,
        duration_s=sim.sim_time,
        played=played,
        real_time_factor=rate.factor,
        policy=policy_record(watch.policy) if plan.policy is not None else None,
        outcome=word,
    )


class _Rate:
    """Simulated by wall time, from the first look after the warm-up to the newest."""

    def __init__(self) -> None:
        self._looks: list[tuple[float, float]] = []

    def look(self, seconds: float) -> None:
        """The simulated time now; a new one counts from when it was first seen."""
        if seconds >= WARM_UP_S and (not self._looks or seconds > self._looks[-1][0]):
            self._looks[1:] = [(seconds, time.monotonic())]

    @property
    def factor(self) -> float | None:
        """None while nothing can be said."""
        if not self._looks or self._looks[-1][0] - self._looks[0][0] < WARM_UP_S:
            return None
        simulated, wall = (new - old for old, new in zip(*self._looks, strict=True))
        return simulated / wall


def policy_record(status: Any) -> dict[str, Any]:
    """A surg_msgs/PolicyStatus as ``outcome.json`` and the learning reports keep it."""
    return {
        "state": value_name(status, "state"),
        "reason": status.detail,
        "session": status.session or None,
        "period_ms": 1e3 * status.period,
        "rejected_by_rule": dict(zip(status.rejected_rules, status.rejected_by_rule, strict=True)),
        "malformed": dict(zip(status.malformed_codes, status.malformed, strict=True)),
        "obs_age_ms": _spread(status.obs_age_p50, status.obs_age_p99),
        "round_trip_ms": _spread(status.round_trip_p50, status.round_trip_p99),
        **{name: getattr(status, name) for name in AS_SENT},
    }


def _spread(p50: float, p99: float) -> dict[str, float | None]:
    """Median and 99th percentile [ms]; None: nothing was measured."""
    if not math.isfinite(p50):
        return {"p50": None, "p99": None}
    return {"p50": round(1e3 * p50, 3), "p99": round(1e3 * p99, 3)}


def _progress(seconds: float | None, note: str) -> None:
    """A line for the process that watches this one."""
    print(json.dumps({"seconds": seconds or 0.0, "note": note}), flush=True)


def main(arguments: Sequence[str]) -> int:
    """Play the plan in a folder; the exit status is 0 when there is an outcome."""
    processes.interrupt_on_signals()
    folder = Path(arguments[0])
    try:
        ended = play(read_plan(folder))
    except policy_program.ProgramDied as died:
        ended = Ended(False, str(died), "", 0.0, False, None, outcome=verdicts.CRASHED)
    except CliError as problem:
        warn(str(problem))
        return problem.code
    except KeyboardInterrupt:
        return 130
    paths.write_text(folder / OUTCOME, json.dumps(asdict(ended), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
