"""`./surg run TASK`: episodes of a task through the graph, played by the scripted senders."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surg_cli.graph import policy_program, processes, system, task_episode
from surg_cli.graph.system import Plan
from surg_cli.host import cells, paths
from surg_cli.host.terminal import Problem, Progress, is_interactive, say, table, warn

LAWS = ("ours", "velocity", "paper")
VIEWS = {"none": (), "left": ("left",), "stereo": ("left", "right")}
ROBOT_CELLS = {"ur5e": "sim_two_arms", "panda": "sim_two_arms_panda"}
EXPERT = "expert"
"""The sender of a task whose place a policy takes; the others stay scripted."""
EPISODE_TIMEOUT_S = 1800.0
"""[s] wall clock: longest an episode may take, start and report included."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("task", metavar="TASK", help="name of a task, or the path of its .py file")
    add_options(parser)
    add = parser.add_argument
    add("--seed", type=int, default=0, metavar="S", help="of the first episode; then S + 1, …")
    add("--law", default="ours", metavar="L", help="control law: " + ", ".join(LAWS))
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    add("--robot", default="ur5e", metavar="R", help="ur5e, panda, or a cell with two arms")
    add(
        "--policy",
        metavar="P",
        help="a policy plays instead of the expert: the address at which it connects, such as "
        "tcp://127.0.0.1:5555, or its client's .py file, which is started "
        "(docs/reference/policies.md)",
    )
    add("--policy-keys", type=Path, metavar="DIR", help="folder of ./surg keys")
    add("--privileged", action="store_true", help="the policy may see the simulator's truth")
    add("--free-run", action="store_true", help="with --policy: in real time, not in lock-step")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare what `run` has and `demo` has not."""
    add = parser.add_argument
    add(
        "--setting",
        default="phantom",
        metavar="W",
        help="physical setting: phantom, ex_vivo, in_vivo; several with commas, or all",
    )
    add("--episodes", type=int, default=1, metavar="N", help="of each setting and law (default 1)")
    add(
        "--cameras",
        nargs="?",
        const="stereo",
        default="none",
        choices=tuple(VIEWS),
        help="record the endoscope: left, or stereo (which the bare option means)",
    )


@dataclass(frozen=True)
class Condition:
    """What the episodes of one box in the plots have in common."""

    setting: str
    law: str


def main(options: argparse.Namespace, command: str) -> int:
    """Check everything, play, report; the last line printed is the path of summary.json."""
    settings, laws = _settings(options.setting), _laws(options.law)
    conditions = [Condition(setting, law) for setting in settings for law in laws]
    _check_numbers(options)
    out = paths.run_folder(options.out)
    cell = _cell(options.robot)
    cameras = VIEWS[options.cameras]
    player = _player(options) if command == "run" else None
    loaded = cells.load(cell)
    plan = make_plan(options.task, cell, loaded, conditions, options.seed, cameras, out, player)
    plan = _timed(plan, player is not None and options.free_run)
    out.mkdir(parents=True, exist_ok=True)
    count = len(conditions) * options.episodes
    say(
        f"run: {plan.run_info['title']}, {plan.run_info['robot']}, {', '.join(settings)}, "
        f"{count} episode{'s' * (count != 1)} from seed {options.seed} -> {out}"
    )
    entries: list[dict[str, Any]] = []
    with Progress("run") as progress:
        for condition in conditions:
            for seed in range(options.seed, options.seed + options.episodes):
                one = of_episode(plan, condition, seed, out / "episodes" / f"{len(entries):03d}")
                entries.append(_play(one, len(entries), count, progress))
    summary = _report(plan, entries, out)
    _print_summary(summary)
    for reason in summary["reasons"]:
        warn(f"surg: {reason}")
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


def real_time_factor(task: str, robot: str, seed: int, out: Path, cameras: str = "left") -> float:
    """Simulated by wall time of one episode through the graph, recorded; see `bench sim`.

    Args:
        task: Its name.
        robot: As for `--robot`.
        seed: Of the episode.
        out: Empty folder for it.
        cameras: Which views of 640 x 480 at 20 fps are rendered and recorded.

    Raises:
        Problem: It was not played to its end.
    """
    condition, cell = Condition("phantom", "ours"), _cell(robot)
    plan = make_plan(task, cell, cells.load(cell), [condition], seed, VIEWS[cameras], out)
    with Progress("episode") as progress:
        entry = _play(of_episode(plan, condition, seed, out), 0, 1, progress)
    factor = entry["real_time_factor"]
    if not entry["played"] or factor is None:
        raise Problem(f"no rate: {entry['failure_reason'] or 'the episode is too short'}")
    return float(factor)


# --- what is wanted -----------------------------------------------------------------------------


def _settings(text: str) -> list[str]:
    """Settings by name.

    Raises:
        Problem: One does not exist; lists those that do.
    """
    from surg_sim.physics.patient_settings import SETTINGS, find_setting

    wanted = list(SETTINGS) if text == "all" else text.split(",")
    for name in wanted:
        try:
            find_setting(name)
        except ValueError as error:
            raise Problem(f"--setting {text}: {error}", 2) from error
    return list(dict.fromkeys(wanted))


def _laws(text: str) -> list[str]:
    """Laws by name."""
    wanted = text.split(",")
    for name in wanted:
        if name not in LAWS:
            raise Problem(f"--law {text}: no law '{name}': there are {', '.join(LAWS)}", 2)
    return list(dict.fromkeys(wanted))


def _check_numbers(options: argparse.Namespace) -> None:
    if not 1 <= options.episodes <= 10_000:
        raise Problem(f"--episodes {options.episodes}: 1 to 10000 are allowed", 2)
    if not 0 <= options.seed <= 2**31 - 1 - options.episodes:
        raise Problem(f"--seed {options.seed}: 0 to {2**31 - 1} is allowed", 2)


def _player(options: argparse.Namespace) -> system.Policy | None:
    """The policy that plays, if one does."""
    if options.policy is not None:
        return policy_program.read(options.policy, options.policy_keys, options.privileged)
    for name in ("policy_keys", "privileged", "free_run"):
        if getattr(options, name):
            raise Problem(f"--{name.replace('_', '-')} goes with --policy", 2)
    return None


def _timed(plan: Plan, free_run: bool) -> Plan:
    """The plan in lock-step or in real time."""
    if not free_run:
        return plan
    return replace(plan, lockstep=False, run_info={**plan.run_info, "timing": "freerun"})


def _cell(robot: str) -> Path:
    """The cell for a robot's name, or a cell itself."""
    try:
        return cells.find(ROBOT_CELLS.get(robot, robot))
    except Problem as problem:
        known = ", ".join(ROBOT_CELLS)
        raise Problem(f"--robot {robot}: neither {known} nor a cell ({problem})", 2) from problem


def make_plan(
    task: str,
    cell: Path,
    loaded: Any,
    conditions: Sequence[Condition],
    seed: int,
    cameras: tuple[str, ...],
    out: Path,
    player: system.Policy | None = None,
) -> Plan:
    """What every episode of a run has in common; nothing has been started.

    Args:
        task: Its name, or the path of its file.
        cell: Folder of the cell.
        loaded: The cell.
        conditions: What it is played in.
        seed: Of the first episode.
        cameras: Views that are rendered and recorded.
        out: Folder of the run.
        player: Plays in the place of the scripted expert.

    Raises:
        Problem: The task is unknown, does not fit the cell, or has nobody who plays it.
    """
    from surg_sim import tasks
    from surg_sim.physics.patient_settings import find_setting

    if task.endswith(".py"):
        task = str(Path(task).absolute())
    try:
        for each in conditions:
            found = tasks.load(task)
            found.prepare(loaded, find_setting(each.setting))
        senders = {name: tuple(e.arms) for name, e in found.experts(loaded, seed).items()}
    except ValueError as error:  # a TaskError is one
        raise Problem(str(error), 2) from error
    if player is not None:
        senders.pop(EXPERT, None)
        senders[system.POLICY] = tuple(found.commanded)
    if not senders:
        raise Problem(f"task '{found.name}' has no scripted sender: nobody would play it", 2)
    arms = tuple(str(arm) for arm in loaded.arms)
    return Plan(
        cell=cell,
        arms=arms,
        lockstep=True,
        cameras=cameras,
        task=task,
        senders=senders,
        policy=player,
        out=out,
        run_info={
            "task": found.name,
            "title": found.title,
            "operator": "scripted expert" if player is None else _named(player),
            "robot": loaded.arms[arms[0]].robot.name,
            "mode": "cartesian",
            "timing": "lockstep",
        },
    )


def _named(player: system.Policy) -> str:
    """A policy in the manifest."""
    return f"policy {Path(player.script).name if player.script else 'at ' + player.address}"


def of_episode(plan: Plan, condition: Condition, seed: int, folder: Path) -> Plan:
    """The plan of one episode of a run."""
    info = {**plan.run_info, "seed": seed, "setting": condition.setting, "law": condition.law}
    player = None if plan.policy is None else policy_program.addressed(plan.policy)
    return replace(
        plan,
        setting=condition.setting,
        law=condition.law,
        seed=seed,
        policy=player,
        out=folder,
        run_info=info,
    )


# --- playing ------------------------------------------------------------------------------------


def _play(plan: Plan, index: int, count: int, progress: Progress) -> dict[str, Any]:
    """Play one episode in a process of its own; returns its entry in the summary."""

    def show(seconds: float, note: str) -> None:
        where = f"episode {index + 1} of {count}, seed {plan.seed}, {plan.setting}"
        progress.update(index / count, f"{where}: {seconds:.1f} s, {note}")

    task_episode.write_plan(plan)
    words = run_process(plan.out, show)
    file = plan.out / task_episode.OUTCOME
    if file.exists():
        ended = task_episode.Ended(**json.loads(file.read_text("utf-8")))
    else:
        ended = task_episode.Ended(False, words, "", 0.0, False, None)
    entry = _describe(plan, ended)
    if not is_interactive():
        end = "success" if ended.success else f"failed: {ended.reason.splitlines()[0]}"
        say(f"  episode {index + 1} of {count}, seed {plan.seed}, {plan.setting}: {end}")
    return entry


def run_process(folder: Path, show: Callable[[float, str], None]) -> str:
    """Run the process of one episode.

    Args:
        folder: With its plan.
        show: Called with the simulated time [s] and words on how far it is.

    Returns:
        What it said on ending without an outcome; empty when there is one.
    """
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    argv = [sys.executable, "-s", "-m", "surg_cli.graph.task_episode", str(folder)]
    logs = folder / "logs"
    with processes.Supervisor(env, logs) as supervisor:
        child = supervisor.start("episode", argv)
        give_up = time.monotonic() + EPISODE_TIMEOUT_S
        while child.exit_code is None and time.monotonic() < give_up:
            time.sleep(0.1)
            lines = child.log_tail(1)
            if lines.startswith("{"):
                news = json.loads(lines)
                show(news["seconds"], news["note"])
    if child.exit_code == 0:
        return ""
    said = [line for line in child.log_tail(20).splitlines() if not line.startswith('{"seconds"')]
    return "\n".join(said) or f"the episode's process ended with {child.exit_code}"


def _describe(plan: Plan, ended: task_episode.Ended) -> dict[str, Any]:
    """The entry of an episode, its own report beside its recording."""
    from surg_recording.episode import episode_reader as episodes
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.reports import run_report, trials

    outcome = trials.Outcome(
        ended.success, ended.reason, ended.phase, ended.duration_s, ended.played
    )
    try:
        recorded = episodes.read(plan.out / "episode")
        entry = trials.describe(plan.seed, plan.setting, plan.law, outcome, recorded)
        run_report.make(plan.out)
    except EpisodeError as error:
        outcome = replace(outcome, played=False, success=False)
        outcome = replace(outcome, reason="; ".join(filter(None, (ended.reason, str(error)))))
        entry = trials.describe(plan.seed, plan.setting, plan.law, outcome, None)
    entry["real_time_factor"] = ended.real_time_factor
    if plan.policy is not None:
        entry["policy"] = ended.policy
    entry["folder"] = f"episodes/{plan.out.name}"
    return entry


# --- what came out ------------------------------------------------------------------------------


def _report(plan: Plan, entries: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Write summary.json, figures and report.html."""
    from surg_recording.episode import provenance
    from surg_recording.reports import trial_report, trials

    info = {
        "task": plan.run_info["task"],
        "robot": plan.run_info["robot"],
        "cell": plan.cell.name,
        "time": plan.mode,
        "versions": provenance.versions(),
    }
    summary = trials.summarise(entries, info)
    trial_report.write(summary, out)
    return summary


def _print_summary(summary: dict[str, Any]) -> None:
    """Print the figures a person looks for first, and every failure with its cause."""
    from surg_recording.reports.trial_report import interval

    rows = [["setting", "law", "success", "RCM mean [mm]", "RCM max [mm]", "true RCM max [mm]"]]
    for c in summary["conditions"]:
        kinematic, true = c["rcm_kinematic_mm"], c["rcm_true_mm"]
        spreads = (kinematic["mean"], kinematic["max"], true["max"])
        rows.append(
            [c["setting"], c["law"], interval(c["success_rate"]), *map(_median_and_worst, spreads)]
        )
    say(table(rows))
    for i, e in enumerate(summary["episodes"]):
        if not e["success"]:
            say(f"  failed: episode {i}, seed {e['seed']}, {e['setting']}: {e['failure_reason']}")


def _median_and_worst(spread: dict[str, Any]) -> str:
    if not spread["n"]:
        return "not measured"
    return f"{spread['median']:.4g} (worst {spread['max']:.4g})"
