"""The stages of `./surg learn` before the roll-outs: demonstrations to weights, without ROS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_learn.learn_terminal import LearnError, Terminal
from surg_learn.recipes import PUSH_M, Request
from surg_learn.stage_ledger import Ledger

if TYPE_CHECKING:
    from surg_sim.envs.demonstrations import DemonstrationPlan

COMPARED = 20
"""Demonstrations whose smoothness is in the report, at most."""


def prepare(
    request: Request,
    ledger: Ledger,
    cell: Path,
    out: Path,
    terminal: Terminal,
    more_views: Sequence[str] = (),
) -> dict[str, Any]:
    """Do the stages; returns the result of each by name.

    ``more_views`` of the endoscope are recorded beside those of the recipe, which alone are
    trained with: they make no other run of it.
    """
    played = ledger.stage(
        "demonstrations",
        request.demonstrations,
        lambda: demonstrate(request, cell, out, terminal, more_views),
    )
    if more_views and not recorded(request, cell, out, more_views):
        raise LearnError(
            f"{out}: its demonstrations lack one of the views {' and '.join(more_views)}; name "
            "another folder with --out",
            2,
        )
    return {
        "demonstrations": played,
        "smoothness": ledger.stage("smoothness", {}, lambda: measure(request, out, terminal)),
        "dataset": ledger.stage("dataset", {}, lambda: export(out, terminal)),
        "training": ledger.stage(
            "training",
            {"seed": request.seed, "method": request.method, "by": request.recipe.digest},
            lambda: train(request, out, terminal),
        ),
    }


def plan_of(
    request: Request, cell: Path, out: Path, more_views: Sequence[str]
) -> DemonstrationPlan:
    """What all demonstrations have in common."""
    from surg_sim.envs import demonstrations

    return demonstrations.DemonstrationPlan(
        out / "demonstrations",
        cell,
        request.task,
        request.setting,
        tuple(dict.fromkeys((*request.recipe.cameras, *more_views))),
        shake=PUSH_M,
        expert_noise=request.recipe.expert_noise,
        randomization=request.look_ranges,
    )


def recorded(request: Request, cell: Path, out: Path, more_views: Sequence[str]) -> bool:
    """Whether all demonstrations are there, with these views too."""
    from surg_sim.tasks import episode_seeds

    plan = plan_of(request, cell, out, more_views)
    return all(plan.done(seed) for seed in episode_seeds.training_seeds(request.episodes))


def demonstrate(
    request: Request, cell: Path, out: Path, terminal: Terminal, more_views: Sequence[str] = ()
) -> dict[str, Any]:
    """Play demonstrations by the scripted expert, in processes of their own, without ROS."""
    from surg_recording.episode import episode_reader
    from surg_recording.episode.verdicts import verdict
    from surg_recording.recording_errors import EpisodeError
    from surg_sim.envs import demonstrations
    from surg_sim.tasks import episode_seeds

    plan = plan_of(request, cell, out, more_views)
    chosen = episode_seeds.training_seeds(request.episodes)
    before = sum(plan.done(seed) for seed in chosen)
    with terminal.Progress("demonstrations") as progress:

        def show(made: int, newest: demonstrations.Demonstration) -> None:
            n = before + made
            progress.update(n / request.episodes, f"{n} of {request.episodes}, seed {newest.seed}")

        try:
            demonstrations.play(plan, chosen, _jobs(), show)
        except (EpisodeError, OSError, ValueError) as problem:
            raise LearnError(str(problem)) from problem
    judged = {seed: verdict(episode_reader.read(plan.folder(seed)).manifest) for seed in chosen}
    failed = {seed: each.reason for seed, each in judged.items() if not each.success}
    for seed, reason in failed.items():
        terminal.say(f"  failed, left out of the dataset: seed {seed}: {reason}")
    return {"success": len(judged) - len(failed), "failed": failed}


def measure(request: Request, out: Path, terminal: Terminal) -> list[dict[str, Any]]:
    """Compute the figures of unperturbed demonstrations that the roll-outs are compared with."""
    from surg_recording.reports import learning
    from surg_sim.tasks import episode_seeds

    unperturbed = episode_seeds.training_seeds(request.episodes)[0::2]
    folders = [out / "demonstrations" / str(seed) for seed in unperturbed[:COMPARED]]
    forked = get_context("fork")
    with terminal.Progress("smoothness") as progress, ProcessPoolExecutor(_jobs(), forked) as pool:
        entries = []
        for entry in pool.map(learning.demonstration, folders):
            entries.append(entry)
            progress.update(len(entries) / len(folders), "of the demonstrations")
    return entries


def export(out: Path, terminal: Terminal) -> dict[str, Any]:
    """Export all demonstrations that succeeded as one dataset."""
    from surg_core.contract import GRID_RATE
    from surg_recording import datasets

    exporter = datasets.load("lerobot")
    options = datasets.ExportOptions(
        fps=GRID_RATE,
        splits={"train": 0.95, "val": 0.05},
        where="success",
        workers=_jobs(),
        keep_parts=True,
        replace=True,
    )
    with terminal.Progress("dataset") as progress:
        try:
            report = exporter.write(
                [out / "demonstrations"], out / "dataset", options, progress.update
            )
        except datasets.ExportError as problem:
            raise LearnError(str(problem)) from problem
    if not report.ok:
        raise LearnError("; ".join([*report.errors, *report.refused.values()][:3]))
    return {"recordings": report.recordings, "frames": report.frames}


def check_device(request: Request) -> None:
    """Refuse a GPU that the trainer cannot use.

    Raises:
        LearnError: With the trainer's own words.
    """
    if request.device != "cuda":
        return
    if not request.recipe.devices:
        raise LearnError(
            f"--device {request.device}: the policy that observes the simulator's truth is trained "
            "on the processor; leave --device out, or train one from pictures with --cameras",
            2,
        )
    argv = [sys.executable, "-m", request.recipe.devices, request.device]
    asked = subprocess.run(argv, capture_output=True, text=True, check=False)
    if asked.returncode != 0:
        raise LearnError(asked.stderr.strip().splitlines()[-1], 2)


def train(request: Request, out: Path, terminal: Terminal) -> dict[str, Any]:
    """Train with the program that a person would start, in a process of its own."""
    program = request.recipe.train
    argv = [sys.executable, "-m", program, str(out / "dataset"), "--json"]
    if method := request.recipe.method:
        from surg_sim import tasks

        argv += ["--method", method, "--arm", *tasks.load(request.task).commanded]
    argv += ["--out", str(out / "weights.npz"), "--seed", str(request.seed)]
    if request.recipe.devices:
        argv += ["--device", request.device]
    with terminal.Progress("training") as progress:
        last = follow(
            argv, out / "logs" / "training.log", lambda n: progress.update(n["part"], n["note"])
        )
    if "weights" not in last:
        raise LearnError(f"{program} ended without naming its weights: {last}")
    return last


def follow(argv: list[str], log: Path, show: Callable[[Mapping[str, Any]], None]) -> dict[str, Any]:
    """Run a program that prints its progress in lines of JSON; returns the last line.

    Raises:
        LearnError: The program failed; with the end of its log.
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
        tail = log.read_text("utf-8", errors="replace").strip().splitlines()[-3:]
        raise LearnError("\n".join(tail) or f"{' '.join(argv[1:3])} ended with {status}")
    return last


def _jobs() -> int:
    return len(os.sched_getaffinity(0))
