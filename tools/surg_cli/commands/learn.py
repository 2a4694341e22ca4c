"""`./surg learn TASK`: demonstrations, data set, training, deployment in the graph, report."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from surg_cli.commands import run
from surg_cli.graph import rollouts
from surg_cli.host import cells, paths
from surg_cli.host.stages import Ledger
from surg_cli.host.terminal import Problem, Progress, say, table, warn

LEARNERS = paths.ROOT / "examples/bgr"


@dataclass(frozen=True)
class Recipe:
    """The programs that train and run a policy; files in `LEARNERS`.

    Attributes:
        train: Trains.
        serve: The policy's client.
        parts: What these two import.
        cameras: Views of the endoscope that are recorded and served.
        episodes: Demonstrations, where nothing else is asked for.
        hoped: Share of the roll-outs that are to succeed.
    """

    train: str
    serve: str
    parts: tuple[str, ...]
    cameras: tuple[str, ...] = ()
    episodes: int = 80
    hoped: float = 0.85
    """The paper's 17 of 20."""

    @property
    def made_of(self) -> list[str]:
        """Digests of all its files."""
        files = (self.train, self.serve, *self.parts)
        return [paths.file_digest(LEARNERS / name) for name in files]

    def folder(self, weights: str) -> str:
        """Name for the roll-outs of these weights, played by these programs and no others."""
        return hashlib.sha256(" ".join((weights, *self.made_of)).encode()).hexdigest()[:12]

    def least(self, rollouts: int) -> int:
        """How many of so many roll-outs have to succeed."""
        return math.ceil(self.hoped * rollouts - 1e-9)  # a float product can be a hair above


RECIPES = {"bgr": Recipe("train_bgr.py", "bgr_policy.py", ("bgr_training.py",))}
"""By task: from the simulator's truth."""
LOOKING = {
    "bgr": Recipe(
        "train_bgr_images.py",
        "bgr_image_policy.py",
        ("bgr_training.py", "bgr_policy.py"),
        cameras=("left",),
        episodes=60,
        hoped=0.0,  # its figure is stated, whatever it is
    )
}
"""By task: from pictures, with ``--cameras``."""
SHAKE = 0.003
"""Spread of the pushes in every second demonstration [m], see surg_sim.tasks.perturbed_sender."""
COMPARED = 20
"""Demonstrations whose smoothness stands in the report, at most."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = (
        "With the --out of a run that was cut off, it goes on where it ended."
        " docs/guide/learning.md"
    )
    add = parser.add_argument
    add("task", metavar="TASK", help=", ".join(RECIPES))
    add("--setting", default="phantom", metavar="W", help="phantom, ex_vivo or in_vivo")
    add("--robot", default="ur5e", metavar="R", help="ur5e, panda, or a cell with two arms")
    add("--seed", type=int, default=0, metavar="S", help="of the training (default 0)")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    default, looking = RECIPES["bgr"].episodes, LOOKING["bgr"].episodes
    add(
        "--episodes",
        type=int,
        metavar="N",
        help=f"demonstrations (default {default}, with --cameras {looking})",
    )
    add(
        "--cameras",
        action="store_true",
        help="a policy that looks through the endoscope, at nothing that a robot cannot measure",
    )
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare what `demo --full` has too."""
    add = parser.add_argument
    add("--rollouts", type=int, default=20, metavar="N", help="of the policy (default 20)")


@dataclass(frozen=True)
class Wanted:
    """What a run of `learn` was asked for; kept beside its results."""

    task: str
    setting: str
    robot: str
    seed: int
    episodes: int
    rollouts: int
    cameras: bool = False

    @property
    def recipe(self) -> Recipe:
        """What learns it."""
        return (LOOKING if self.cameras else RECIPES)[self.task]

    @property
    def demonstrations(self) -> dict[str, Any]:
        """What the demonstrations depend on."""
        looks = {"cameras": self.recipe.cameras} if self.cameras else {}
        fixed = {"rollouts": 0, "seed": 0, "shake": SHAKE}
        return {**{k: v for k, v in asdict(self).items() if k != "cameras"}, **fixed, **looks}


def main(options: argparse.Namespace, command: str) -> int:
    """Do all stages; the last line printed is the path of summary.json."""
    from surg_recording.episode import provenance
    from surg_recording.reports import learning, learning_report

    wanted = _check(options)
    out = _folder(options.out, wanted)
    cell = run._cell(wanted.robot)
    loaded = cells.load(cell)
    again = f"./surg {_line(command, wanted)} --out {_shown(out)}"
    ledger = Ledger(out / "stages.json", again)
    recipe = wanted.recipe
    train, serve = (LEARNERS / name for name in (recipe.train, recipe.serve))
    looking = ", from pictures" if wanted.cameras else ""
    say(
        f"learn: {wanted.task}{looking}, {wanted.setting}, {wanted.episodes} demonstrations, "
        f"{wanted.rollouts} roll-outs -> {out}"
    )
    demos = ledger.stage("demonstrations", wanted.demonstrations, lambda: _show(wanted, cell, out))
    shown = ledger.stage("smoothness", {}, lambda: _measure(wanted, out))
    ledger.stage("dataset", {}, lambda: _export(out))
    trained = ledger.stage(
        "training",
        {"seed": wanted.seed, "by": recipe.made_of},
        lambda: _train(train, wanted, out),
    )
    player = rollouts.Player(
        wanted.task,
        cell,
        loaded,
        wanted.setting,
        serve,
        out / "weights.npz",
        bool(trained["privileged"]),
        recipe.cameras,
    )
    entries = ledger.stage(
        "rollouts",
        {"rollouts": wanted.rollouts, "weights": trained["weights"]},
        lambda: _deploy(player, wanted, out / "rollouts" / recipe.folder(trained["weights"])),
        whole=lambda entries: all(e["rollout"]["played"] for e in entries),
    )
    info = {
        **{key: asdict(wanted)[key] for key in ("task", "setting")},
        "title": player.title,
        "robot": player.robot,
        "seed": wanted.seed,
        "demonstrations": wanted.episodes,
        "demonstrations_success": demos["success"],
        "observation": trained["observation"],
        "privileged": trained["privileged"],
        "policy": trained["words"],
        "training": trained,
        "stages_s": ledger.seconds,
        "versions": provenance.versions(),
    }
    least = recipe.least(wanted.rollouts)
    summary = learning.summarise([e["rollout"] for e in entries], shown, info, least)
    learning_report.write(summary, [e["episode"] for e in entries], shown, out)
    _print_summary(summary)
    say(str(out / "report.html"))
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


# --- what is wanted -----------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> Wanted:
    """Find what is wrong before anything begins.

    Raises:
        Problem: Says what, and what is allowed.
    """
    from surg_sim.tasks import episode_seeds

    if options.task not in RECIPES:
        known = ", ".join(RECIPES)
        raise Problem(f"learn {options.task}: there is a trainer for {known} only", 2)
    recipe = (LOOKING if options.cameras else RECIPES)[options.task]
    episodes = recipe.episodes if options.episodes is None else options.episodes
    numbers = (
        ("episodes", episodes, episode_seeds.TRAINING),
        ("rollouts", options.rollouts, episode_seeds.TEST),
    )
    for name, value, whole in numbers:
        if not 1 <= value <= len(whole):
            raise Problem(f"--{name} {value}: 1 to {len(whole)} are allowed", 2)
    if not 0 <= options.seed < 2**31:
        raise Problem(f"--seed {options.seed}: 0 to {2**31 - 1} is allowed", 2)
    if len(run._settings(options.setting)) > 1:
        raise Problem(f"--setting {options.setting}: learn takes one setting", 2)
    return Wanted(
        options.task,
        options.setting,
        options.robot,
        options.seed,
        episodes,
        options.rollouts,
        bool(options.cameras),
    )


def _folder(wanted: Path | None, what: Wanted) -> Path:
    """The folder of the run: a new one, or that of a run that was asked for the same.

    Raises:
        Problem: It holds something else.
    """
    if wanted is not None and (wanted / "wanted.json").is_file():
        try:
            before = json.loads((wanted / "wanted.json").read_text("utf-8"))
        except ValueError as error:
            raise Problem(f"--out {wanted}: wanted.json is not valid JSON ({error})", 2) from error
        now = asdict(what)
        before = {"cameras": False, **before}
        # More roll-outs, or another training on the same demonstrations, is no other run.
        fixed = [name for name in now if name not in ("rollouts", "seed")]
        other = [f"--{n} {before.get(n)}" for n in fixed if before.get(n) != now[n]]
        if other:
            raise Problem(
                f"--out {wanted}: holds a run with {', '.join(other)}; name another folder, or ask"
                " for the same",
                2,
            )
        out = wanted.absolute()
    else:
        out = paths.run_folder(wanted)
    paths.write_text(out / "wanted.json", json.dumps(asdict(what), indent=1) + "\n")
    return out


def _line(command: str, wanted: Wanted) -> str:
    """The command line that asks for the same."""
    first = f"learn {wanted.task}" if command == "learn" else f"{command} --full"
    given = asdict(wanted)
    words = [f"--{name} {given[name]}" for name in given if name not in ("task", "cameras")]
    return " ".join([first, *words, *(["--cameras"] if wanted.cameras else [])])


def _shown(path: Path) -> Path:
    """Relative to where the person is, where that is shorter."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


# --- stages -------------------------------------------------------------------------------------


def _jobs() -> int:
    return len(os.sched_getaffinity(0))


def _show(wanted: Wanted, cell: Path, out: Path) -> dict[str, Any]:
    """Demonstrations of the scripted expert, in processes of their own, without ROS."""
    from surg_recording.episode import episode_reader
    from surg_recording.recording_errors import EpisodeError
    from surg_sim.envs import demonstrations
    from surg_sim.tasks import episode_seeds

    plan = demonstrations.Plan(
        out / "demonstrations",
        cell,
        wanted.task,
        wanted.setting,
        wanted.recipe.cameras,
        shake=SHAKE,
    )
    chosen = episode_seeds.training_seeds(wanted.episodes)
    before = sum(plan.done(seed) for seed in chosen)
    with Progress("demonstrations") as progress:

        def show(made: int, newest: demonstrations.Demonstration) -> None:
            n = before + made
            progress.update(n / wanted.episodes, f"{n} of {wanted.episodes}, seed {newest.seed}")

        try:
            demonstrations.play(plan, chosen, _jobs(), show)
        except (EpisodeError, OSError, ValueError) as problem:
            raise Problem(str(problem)) from problem
    verdicts = {}
    for seed in chosen:
        sim = episode_reader.read(plan.folder(seed)).manifest["sim"]["task"]
        verdicts[seed] = sim["reason"]
    failed = {seed: reason for seed, reason in verdicts.items() if reason}
    for seed, reason in failed.items():
        say(f"  not solved, and not learned from: seed {seed}: {reason}")
    return {"success": len(verdicts) - len(failed), "failed": failed}


def _export(out: Path) -> dict[str, Any]:
    """The data set of all demonstrations that were solved."""
    from surg_recording import datasets

    exporter = datasets.load("lerobot")
    options = datasets.ExportOptions(
        fps=20, splits={"train": 0.95, "val": 0.05}, workers=_jobs(), keep_parts=True, replace=True
    )
    with Progress("dataset") as progress:
        try:
            report = exporter.write(
                [out / "demonstrations"], out / "dataset", options, progress.update
            )
        except datasets.ExportError as problem:
            raise Problem(str(problem)) from problem
    if not report.ok:
        raise Problem("; ".join([*report.errors, *report.refused.values()][:3]))
    return {"recordings": report.recordings, "frames": report.frames}


def _train(program: Path, wanted: Wanted, out: Path) -> dict[str, Any]:
    """Train in a process of its own, so that it is the same program that a person starts."""
    argv = [sys.executable, str(program), str(out / "dataset"), "--json"]
    argv += ["--out", str(out / "weights.npz"), "--seed", str(wanted.seed)]
    with Progress("training") as progress:
        last = follow(
            argv, out / "logs" / "training.log", lambda n: progress.update(n["part"], n["note"])
        )
    if "weights" not in last:
        raise Problem(f"{program.name} ended without saying what it made: {last}")
    return last


def follow(argv: list[str], log: Path, show: Callable[[Mapping[str, Any]], None]) -> dict[str, Any]:
    """Run a program that says how far it is in lines of JSON; returns the last line.

    Raises:
        Problem: It failed; with the end of what it said.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    last: dict[str, Any] = {}
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            argv, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL, text=True
        )
        assert process.stdout is not None
        try:
            for line in process.stdout:
                try:
                    last = json.loads(line)
                except ValueError:
                    errors.write(line)
                    continue
                if "part" in last:
                    show(last)
        except BaseException:
            process.terminate()
            raise
        finally:
            status = process.wait()
    if status != 0:
        said = log.read_text("utf-8", errors="replace").strip().splitlines()[-3:]
        raise Problem("\n".join(said) or f"{Path(argv[1]).name} ended with {status}")
    return last


def _deploy(player: rollouts.Player, wanted: Wanted, folder: Path) -> list[dict[str, Any]]:
    """The policy in the graph, over the wire, on seeds that nothing was chosen with."""
    from surg_sim.tasks import episode_seeds

    found: list[dict[str, Any]] = []
    with Progress("roll-outs") as progress:
        for n, seed in enumerate(episode_seeds.test_seeds(wanted.rollouts)):
            good = sum(e["rollout"]["success"] for e in found)

            def show(seconds: float, note: str, n: int = n, good: int = good) -> None:
                words = f"{n + 1} of {wanted.rollouts}, {good} solved: {seconds:.1f} s, {note}"
                progress.update(n / wanted.rollouts, words)

            found.append(player.play(seed, folder / str(seed), show))
    return found


def _measure(wanted: Wanted, out: Path) -> list[dict[str, Any]]:
    """The same numbers of demonstrations as of roll-outs."""
    from surg_recording.reports import learning
    from surg_sim.tasks import episode_seeds

    chosen = episode_seeds.training_seeds(wanted.episodes)[0::2][
        :COMPARED
    ]  # those that nobody pushed
    folders = [out / "demonstrations" / str(seed) for seed in chosen]
    forked = get_context("fork")
    with Progress("smoothness") as progress, ProcessPoolExecutor(_jobs(), forked) as pool:
        found = []
        for entry in pool.map(learning.demonstration, folders):
            found.append(entry)
            progress.update(len(found) / len(folders), "of the demonstrations")
    return found


# --- what came out ------------------------------------------------------------------------------


def _print_summary(summary: dict[str, Any]) -> None:
    """Print what a person looks for first, and every failure with its cause."""
    from surg_recording.reports.html_page import number
    from surg_recording.reports.trial_report import interval

    smooth = summary["smoothness"]
    rows = [
        ["success", interval(summary["success_rate"])],
        [
            "unsafe commands",
            f"{summary['unsafe_commands']} in {summary['unsafe']['cycles']} cycles",
        ],
        ["RCM deviation, largest", f"{number(summary['rcm_max_mm']['max'])} mm"],
        *(
            [
                f"{name.upper()}, median",
                f"{number(smooth[name]['rollouts']['median'])} (demonstrations "
                f"{number(smooth[name]['demonstrations']['median'])})",
            ]
            for name in ("sparc", "ldlj")
        ),
        [
            "actions",
            ", ".join(f"{number(summary[n])} {n}" for n in ("rejected", "clipped", "late")),
        ],
        [
            "age of observation",
            f"median {number(summary['obs_age_ms']['p50'])}, "
            f"p99 {number(summary['obs_age_ms']['p99'])} ms",
        ],
        ["stages [s]", ", ".join(f"{k} {v:.0f}" for k, v in summary["stages_s"].items())],
    ]
    privileged = ", ".join(summary["privileged"])
    looks = "no: it looks at " + ", ".join(summary["observation"])
    rows.append(["privileged", f"the policy looks at {privileged}" if privileged else looks])
    say(table(rows))
    for e in summary["rollouts"]:
        if not e["success"]:
            say(f"  failed: seed {e['seed']}: {e['reason']}")
    for reason in summary["reasons"]:
        warn(f"surg: {reason}")
