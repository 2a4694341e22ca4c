"""`./surg run TASK`: episodes of a task through the graph, played by the scripted senders."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from surg_cli.graph import (
    episode_film,
    episode_plans,
    episode_process,
    policy_program,
    ros2_gateway,
    task_episode,
)
from surg_cli.graph.episode_plans import VIEWS, Condition
from surg_cli.graph.system_plan import Policy, SystemPlan
from surg_cli.host import cells, paths, preflight
from surg_cli.host.option_types import add_video_quality, video_quality
from surg_cli.host.terminal import CliError, Progress, is_interactive, say, table, warn

LAWS = ("ours", "velocity", "paper")
OBSERVED = ("privileged", "forces")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("task", metavar="TASK", help="name of a task, or the path of its .py file")
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
        help="record the endoscope: left, or stereo (the option without a value)",
    )
    add_video_quality(parser)
    add("--seed", type=int, default=0, metavar="S", help="of the first episode; then S + 1, …")
    add("--law", default="ours", metavar="L", help="control law: " + ", ".join(LAWS))
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    add("--robot", metavar="R", help="ur5e, panda, or a cell (default: the task's home_cell)")
    add(
        "--policy",
        metavar="P",
        help="a policy plays instead of the expert: its address, such as tcp://127.0.0.1:5555, "
        "or the .py file of its client, which is started (docs/reference/policies.md)",
    )
    add("--policy-keys", type=Path, metavar="DIR", help="folder of ./surg policy keys")
    add(
        "--observe",
        nargs="+",
        choices=OBSERVED,
        default=[],
        help="serve more to the policy: privileged: the simulator's truth; forces: at tip and "
        "trocar",
    )
    add("--free-run", action="store_true", help="with --policy: in real time, not in lock-step")
    ros2_gateway.add_arguments(parser, commands=False)


def main(options: argparse.Namespace, command: str) -> int:
    """Check everything, play, report; the last line printed is the path of summary.json."""
    settings, laws = episode_plans.parse_settings(options.setting), _laws(options.law)
    conditions = [Condition(setting, law) for setting in settings for law in laws]
    _check_numbers(options)
    out = paths.run_folder(options.out)
    preflight.check_space(out)
    cell = episode_plans.cell_of(options.task, options.robot)
    policy = _policy(options)
    plan = episode_plans.make_plan(
        options.task,
        cell,
        cells.load(cell),
        conditions,
        options.seed,
        VIEWS[options.cameras],
        out,
        policy,
    )
    if options.free_run:
        plan = replace(plan, lockstep=False, run_info={**plan.run_info, "timing": "freerun"})
    plan = replace(
        plan, record_quality=video_quality(options), ros2=ros2_gateway.parameters(options)
    )
    out.mkdir(parents=True, exist_ok=True)
    count = len(conditions) * options.episodes
    say(
        f"run: {plan.run_info['title']}, {plan.run_info['robot']}, {', '.join(settings)}, "
        f"{count} episode{'s' * (count != 1)} from seed {options.seed} -> {out}"
    )
    seeds = range(options.seed, options.seed + options.episodes)
    summary = _report(plan, _play_all(plan, conditions, seeds, out), out)
    _print_summary(summary)
    say(str(out / "report.html"))
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


# --- input --------------------------------------------------------------------------------------


def _laws(text: str) -> list[str]:
    """Laws by name."""
    wanted = text.split(",")
    for name in wanted:
        if name not in LAWS:
            raise CliError(f"--law {text}: no law '{name}': there are {', '.join(LAWS)}", 2)
    return list(dict.fromkeys(wanted))


def _check_numbers(options: argparse.Namespace) -> None:
    if not 1 <= options.episodes <= 10_000:
        raise CliError(f"--episodes {options.episodes}: 1 to 10000 are allowed", 2)
    if not 0 <= options.seed <= 2**31 - 1 - options.episodes:
        raise CliError(f"--seed {options.seed}: 0 to {2**31 - 1} is allowed", 2)


def _policy(options: argparse.Namespace) -> Policy | None:
    """The policy that plays, if one does."""
    if options.policy is not None:
        more = ("privileged" in options.observe, "forces" in options.observe)
        return policy_program.read(options.policy, options.policy_keys, *more)
    for name in ("policy_keys", "observe", "free_run"):
        if getattr(options, name):
            raise CliError(f"--{name.replace('_', '-')} needs --policy", 2)
    return None


# --- playing ------------------------------------------------------------------------------------


def _play_all(
    plan: SystemPlan, conditions: list[Condition], seeds: range, out: Path
) -> list[dict[str, Any]]:
    """Play every seed in every condition; the entries of the summary."""
    entries: list[dict[str, Any]] = []
    count = len(conditions) * len(seeds)
    with Progress("run") as progress:
        for condition in conditions:
            for seed in seeds:
                folder = out / "episodes" / f"{len(entries):03d}"
                episode = episode_plans.for_episode(plan, condition, seed, folder)
                entries.append(_play(episode, len(entries), count, progress))
    return entries


def _play(plan: SystemPlan, index: int, count: int, progress: Progress) -> dict[str, Any]:
    """Play one episode; its entry in the summary."""
    which = f"episode {index + 1} of {count}, seed {plan.seed}, {plan.setting}"

    def show(seconds: float, note: str) -> None:
        progress.update(index / count, f"{which}: {seconds:.1f} s, {note}")

    ended: task_episode.Ended = episode_process.run_episode(plan, show)
    entry = episode_process.describe(plan, ended)
    if not is_interactive():
        lines = ended.reason.splitlines() or [""]
        why = "" if ended.success else f": {' '.join(dict.fromkeys((lines[0], lines[-1])))}"
        say(f"  {which}: {ended.outcome}{why}")
    for warning in filter(None, ((ended.policy or {}).get("warning"), ended.warning)):
        warn(f"surg: {which}: {warning}")
    return entry


# --- results ------------------------------------------------------------------------------------


def _report(plan: SystemPlan, entries: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Write summary.json, figures and report.html."""
    from surg_recording.episode import provenance
    from surg_recording.reports import trial_report, trials

    info = {
        "task": plan.run_info["task"],
        "title": plan.run_info["title"],
        "robot": plan.run_info["robot"],
        "cell": plan.cell.name,
        "time": plan.mode,
        "versions": provenance.versions(),
    }
    summary = trials.summarise(entries, info)
    ranked = sorted(entries, key=lambda entry: not entry["success"])
    folders = [out / entry["folder"] / "episode" for entry in ranked if entry.get("folder")]
    episode_film.for_report(folders if plan.cameras else [], plan.cell, out)
    trial_report.write(summary, out)
    return summary


def _print_summary(summary: dict[str, Any]) -> None:
    """Print the main figures, and every failure with its cause."""
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
            what = f"{e['outcome']}: episode {i}, seed {e['seed']}, {e['setting']}"
            tell = say if e["played"] else warn
            tell(f"  {what}: {e['failure_reason']}")


def _median_and_worst(spread: dict[str, Any]) -> str:
    if not spread["n"]:
        return "not measured"
    return f"{spread['median']:.4g} (worst {spread['max']:.4g})"
