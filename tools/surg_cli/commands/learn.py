"""`./surg learn TASK`: demonstrations, dataset, training, deployment in the graph, report."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from surg_cli.graph import episode_film, episode_plans
from surg_cli.host import cells, paths, preflight, provision, terminal
from surg_cli.host.terminal import CliError, say, table, warn
from surg_cli.learning import rollouts
from surg_learn import learn_stages
from surg_learn.cloning.training.torch_device import DEVICES
from surg_learn.learn_terminal import LearnError
from surg_learn.recipes import BUILT_IN, LOOKS, METHODS, STATE, Request, recipe_of
from surg_learn.stage_ledger import Ledger

RANDOMIZATION = "--domain-randomization"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = "To resume an interrupted run, name its --out again. docs/guide/learning.md"
    add = parser.add_argument
    add("task", metavar="TASK", help="any with --cameras; bgr without, too")
    add("--setting", default="phantom", metavar="W", help="phantom, ex_vivo or in_vivo")
    add("--robot", metavar="R", help="ur5e, panda, or a cell (default: the task's home_cell)")
    add("--seed", type=int, default=0, metavar="S", help="of the training (default 0)")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    state, camera = recipe_of("bgr", STATE).episodes, LOOKS.episodes
    add(
        "--episodes",
        type=int,
        metavar="N",
        help=f"demonstrations (default {state}, with --cameras {camera})",
    )
    add("--rollouts", type=int, default=20, metavar="N", help="of the policy (default 20)")
    add(
        "--cameras",
        dest="method",
        nargs="?",
        const=next(iter(METHODS)),
        default=STATE,
        metavar="METHOD",
        help="a policy that observes camera images and joint states, not the simulator's truth: "
        f"{', '.join(METHODS)}; for bgr keypoints, too (default {next(iter(METHODS))})",
    )
    add(
        RANDOMIZATION,
        dest="looks",
        nargs="?",
        const=BUILT_IN,
        default="",
        metavar="FILE",
        help="demonstrations draw light, tissue and lens, from built-in ranges or those of a file",
    )
    add("--device", choices=DEVICES, default="auto", help="where it trains (default: a GPU if any)")


def main(options: argparse.Namespace, command: str) -> int:
    """Do all stages; the last line printed is the path of summary.json."""
    try:
        return _main(check(options), options.out)
    except LearnError as problem:
        raise CliError(str(problem), problem.code) from problem


def _main(request: Request, wanted: Path | None) -> int:
    if request.recipe.packages:
        provision.install_packages(
            paths.STATE / "logs" / "apt.log", optional=request.recipe.packages
        )
    learn_stages.check_device(request)
    out = folder_of(wanted, request)
    say(
        f"learn: {request.task}{f', {request.method} from images' if request.cameras else ''}, "
        f"{request.setting}, {request.episodes} demonstrations, {request.rollouts} roll-outs "
        f"-> {out}"
    )
    ledger = Ledger(out / "stages.json", command_line(request, out), say)
    summary = _learn(request, ledger, out)
    _print_summary(summary)
    say(str(out / "report.html"))
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


def _learn(request: Request, ledger: Ledger, out: Path) -> dict[str, Any]:
    """All stages, and the report; returns the summary."""
    from surg_recording.reports import learning, learning_report

    cell = episode_plans.find_cell(request.robot)
    loaded = cells.load(cell)
    recipe = request.recipe
    done = learn_stages.prepare(request, ledger, cell, out, terminal)
    trained, compared = done["training"], done["smoothness"]
    player = rollouts.Player(
        request.task,
        cell,
        loaded,
        request.setting,
        recipe.script,
        out / "weights.npz",
        bool(trained["privileged"]),
        recipe.cameras,
        "observation.force" in trained["observation"],
    )
    folder = out / "rollouts" / recipe.folder(trained["weights"])
    entries = ledger.stage(
        "rollouts",
        {"rollouts": request.rollouts, "weights": trained["weights"]},
        lambda: rollouts.roll_out(player, request.rollouts, folder),
        complete=lambda entries: all(e["rollout"]["played"] for e in entries),
    )
    info = _info(request, player, done["demonstrations"], trained, ledger)
    least = recipe.least(request.rollouts)
    summary = learning.summarise([e["rollout"] for e in entries], compared, info, least)
    played = [e["rollout"] for e in entries if e["rollout"]["played"]]
    folders = ((bool(e["success"]), folder / str(e["seed"]) / "episode") for e in played)
    episode_film.of_outcomes(folders, cell, out)
    learning_report.write(summary, [e["episode"] for e in entries], compared, out)
    return summary


def _info(
    request: Request,
    player: rollouts.Player,
    demos: dict[str, Any],
    trained: dict[str, Any],
    ledger: Ledger,
) -> dict[str, Any]:
    """What the summary says of the run beside its figures."""
    from surg_recording.episode import provenance

    return {
        "task": request.task,
        "setting": request.setting,
        "title": player.title,
        "robot": player.robot,
        "seed": request.seed,
        "demonstrations": request.episodes,
        "demonstrations_success": demos["success"],
        "observation": trained["observation"],
        "privileged": trained["privileged"],
        "policy": trained["words"],
        "training": trained,
        "stages_s": ledger.seconds,
        "versions": provenance.versions(),
    }


# --- input --------------------------------------------------------------------------------------


def check(options: argparse.Namespace) -> Request:
    """Check all options before anything starts."""
    from surg_sim import tasks
    from surg_sim.tasks import episode_seeds

    try:
        home = tasks.load(options.task).home_cell
        recipe = recipe_of(options.task, options.method)
    except ValueError as problem:
        raise CliError(str(problem), 2) from problem
    episodes = recipe.episodes if options.episodes is None else options.episodes
    numbers = (
        ("episodes", episodes, episode_seeds.TRAINING),
        ("rollouts", options.rollouts, episode_seeds.TEST),
    )
    for name, value, seeds in numbers:
        if not 1 <= value <= len(seeds):
            raise CliError(f"--{name} {value}: 1 to {len(seeds)} are allowed", 2)
    if not 0 <= options.seed < 2**31:
        raise CliError(f"--seed {options.seed}: 0 to {2**31 - 1} is allowed", 2)
    if len(episode_plans.parse_settings(options.setting)) > 1:
        raise CliError(f"--setting {options.setting}: learn takes one setting", 2)
    request = Request(
        options.task,
        options.setting,
        options.robot or home,
        options.seed,
        episodes,
        options.rollouts,
        options.method,
        options.device,
        looks_of(options.looks),
    )
    if request.looks and not request.cameras:
        raise CliError(f"{RANDOMIZATION}: without --cameras no picture is recorded", 2)
    try:
        _ = request.look_ranges
    except ValueError as problem:
        raise CliError(f"{RANDOMIZATION}: {problem}", 2) from problem
    return request


def looks_of(given: str) -> str:
    """As a request holds it: a file by its whole path."""
    return given if given in ("", BUILT_IN) else str(Path(given).absolute())


def folder_of(wanted: Path | None, request: Request) -> Path:
    """The folder of the run: a new one, or that of a run with the same options."""
    ranges = _look_ranges(request)
    if wanted is not None and (wanted / "wanted.json").is_file():
        try:
            before = json.loads((wanted / "wanted.json").read_text("utf-8"))
        except ValueError as error:
            raise CliError(f"--out {wanted}: wanted.json is not valid JSON ({error})", 2) from error
        now = asdict(request)
        # Of a version with one method for pictures: it had a place of its own for that.
        method = "keypoints" if before.get("cameras") else STATE
        before = {"method": method, "device": "auto", "looks": "", **before}
        if before.get("look_ranges"):  # the file may have moved, or changed where it is
            same = before["look_ranges"] == ranges
            before["looks"] = now["looks"] if same else f"{before['looks']} as it was"
        before["cameras"], now["cameras"] = before["method"] != STATE, request.cameras
        # The same demonstrations serve other numbers of roll-outs and other trainings.
        fixed = [name for name in now if name not in ("rollouts", "seed", "device", "method")]
        names = {"looks": RANDOMIZATION}
        other = [
            f"{names.get(n, f'--{n}')} {before.get(n)}" for n in fixed if before.get(n) != now[n]
        ]
        if other:
            raise CliError(
                f"--out {wanted}: holds a run with {', '.join(other)}; name another folder, or the"
                " same options",
                2,
            )
        out = wanted.absolute()
    else:
        out = paths.run_folder(wanted)
    preflight.check_space(out)
    kept = {**asdict(request), "look_ranges": ranges}
    paths.write_text(out / "wanted.json", json.dumps(kept, indent=1) + "\n")
    return out


def _look_ranges(request: Request) -> dict[str, Any] | None:
    """What a file of looks holds, as JSON has it."""
    ranges = request.look_ranges
    return None if ranges is None else json.loads(json.dumps(asdict(ranges)))


def command_line(request: Request, out: Path) -> str:
    """The command line that goes on with the same request."""
    given = asdict(request)
    words = [
        f"--{n} {v}" for n, v in given.items() if n not in ("task", "method", "device", "looks")
    ]
    words += [f"--cameras {request.method}"] if request.cameras else []
    looks = RANDOMIZATION if request.looks == BUILT_IN else f"{RANDOMIZATION} {request.looks}"
    words += [looks] if request.looks else []
    words += [f"--device {request.device}"] if request.device != "auto" else []
    shown = out.relative_to(Path.cwd()) if out.is_relative_to(Path.cwd()) else out
    return " ".join(["./surg learn", request.task, *words, f"--out {shown}"])


# --- results ------------------------------------------------------------------------------------


def _print_summary(summary: dict[str, Any]) -> None:
    """Print the main figures, and every failure with its cause."""
    from surg_recording.reports.html_page import number
    from surg_recording.reports.trial_report import interval

    smooth, age = summary["smoothness"], summary["obs_age_ms"]
    unsafe = f"{summary['unsafe_commands']} in {summary['unsafe']['cycles']} cycles"
    rows = [
        ["success", interval(summary["success_rate"])],
        ["unsafe commands", unsafe],
        ["RCM deviation, largest", f"{number(summary['rcm_max_mm']['max'])} mm"],
    ]
    for name in ("sparc", "ldlj"):
        medians = [number(smooth[name][key]["median"]) for key in ("rollouts", "demonstrations")]
        rows.append([f"{name.upper()}, median", "{} (demonstrations {})".format(*medians)])
    counts = [f"{number(summary[n])} {n}" for n in ("rejected", "clipped", "late")]
    observed = ", ".join(summary["privileged"]) or (
        "no: the policy observes " + ", ".join(summary["observation"])
    )
    rows += [
        ["actions", ", ".join(counts)],
        ["age of observation", f"median {number(age['p50'])}, p99 {number(age['p99'])} ms"],
        ["stages [s]", ", ".join(f"{k} {v:.0f}" for k, v in summary["stages_s"].items())],
        ["privileged", observed],
    ]
    say(table(rows))
    for e in summary["rollouts"]:
        if not e["success"]:
            say(f"  failed: seed {e['seed']}: {e['reason']}")
    for reason in summary["reasons"]:
        warn(f"surg: {reason}")
