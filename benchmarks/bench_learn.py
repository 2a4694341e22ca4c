"""Does the learned policy of bgr hold up: other training seeds, fewer demonstrations, no policy.

In process (`surg_sim.envs.policy_rollouts`), on test seeds: 80 demonstrations with each of three
training
seeds, 10, 4 and 2 demonstrations, 40 and 10 that were copied plainly (nobody pushed the hand, no
sample is moved aside or shown late), an arm that holds, one that moves at random, and one that
replays a demonstration blindly. `--json FILE` writes (counts of successes and Wilson's 95 %
interval):

    format         "surg_bench_learn/1"
    machine        {processor, cores, load_before, load_after, date}
    seeds          first and last + 1 of the episodes judged
    policies       [{name, demonstrations, training_seed, plain, n, k, low, high, asked, met,
                   refused, rcm_max_mm, training_cpu_s, failures: {reason: count}}]
    wall_s         of everything

`asked` are the smallest and the largest share of successes; the exit code is 1 when one is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from machine import this_machine

from surg_cli.host.terminal import Progress, say, table
from surg_core.contract import STATE_KEY
from surg_recording import datasets
from surg_recording.reports import trials
from surg_sim.envs import demonstrations
from surg_sim.envs.policy_rollouts import Rollout
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds

CELL, TASK = "sim_two_arms", "bgr"
SET, JAW = slice(5, 9), 4
PLAIN: dict[str, Any] = {"push": 0.0, "behind": 0}
"""Options of `train_state` for copying what was shown, and no more."""


class Hold:
    """Stays where it is."""

    def reset(self, instruction: str, seed: int | None) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> Any:
        """The set-point, again."""
        state = observation[STATE_KEY]
        return np.append(state[SET], state[JAW])[None]


class Random(Hold):
    """Goes 3 mm a step in a direction that changes at random, and snaps at random."""

    def reset(self, instruction: str, seed: int | None) -> None:
        """Another walk for each episode."""
        self._rng = np.random.default_rng(seed)
        self._direction, self._jaw = np.zeros(3), 0.0

    def act(self, observation: Any) -> Any:
        """A step from the set-point."""
        if self._rng.random() < 0.1:
            direction = self._rng.standard_normal(3)
            self._direction = 0.003 * direction / np.linalg.norm(direction)
            self._jaw = float(self._rng.uniform(0.0, 0.68))
        held = observation[STATE_KEY][SET].copy()
        held[:3] += self._direction
        # Inside what the shaft reaches, so that it goes on.
        held[2] = min(max(held[2], 0.06), 0.18)
        held[:2] = np.clip(held[:2], -0.05, 0.05)
        return np.append(held, self._jaw)[None]


class Replay(Hold):
    """Says what was said in a demonstration, whatever it sees.

    Args:
        actions: (T, 5) of the demonstration.
    """

    def __init__(self, actions: Any) -> None:
        self._actions = actions

    def reset(self, instruction: str, seed: int | None) -> None:
        """From the beginning."""
        self._step = 0

    def act(self, observation: Any) -> Any:
        """The next one; the last one for ever."""
        action = self._actions[min(self._step, len(self._actions) - 1)]
        self._step += 1
        return action[None]


@dataclass(frozen=True)
class Candidate:
    """Something to be judged.

    Attributes:
        name: For the table.
        make: Makes the policy, in a process of its own.
        asked: Smallest and largest share of successes.
        facts: What else is to be said.
    """

    name: str
    make: Callable[[], Any]
    asked: tuple[float, float] = (0.0, 1.0)
    facts: dict[str, Any] = field(default_factory=dict)


def learned(weights: Path) -> Any:
    """The policy of a file of weights."""
    from surg_learn.bgr.state_policy import Policy

    return Policy.load(weights)


def replayed(dataset: Path) -> Any:
    """The first demonstration of a dataset."""
    from surg_learn.bgr import train_state

    return Replay(train_state.read(dataset).episodes["train"][0].action)


_environments: dict[str, Any] = {}


def judge(make: Callable[[], Any], seed: int) -> Rollout:
    """One roll-out; the scene is compiled once per process."""
    from surg_sim.envs.policy_rollouts import roll_out
    from surg_sim.envs.surg_env import SurgEnv

    if TASK not in _environments:
        _environments[TASK] = SurgEnv(TASK, CELL)
    return roll_out(_environments[TASK], make(), seed)


def export(recordings: list[Path], out: Path) -> Path:
    """A dataset of some demonstrations."""
    options = datasets.ExportOptions(splits={"train": 0.95, "val": 0.05}, keep_parts=False)
    report = datasets.load("lerobot").write(recordings, out, options)
    if not report.ok:
        raise RuntimeError("; ".join([*report.errors, *report.refused.values()]))
    return out


def train(dataset: Path, out: Path, seed: int, plain: bool = False) -> dict[str, Any]:
    """Weights, and what they cost."""
    from surg_learn.bgr import train_state

    before = time.process_time()
    chosen = train_state.Options(seed=seed, **(PLAIN if plain else {}))
    policy = train_state.train(train_state.read(dataset), chosen)
    policy.save(out)
    count = sum(policy.about["episodes"].values())
    spent = round(time.process_time() - before, 1)
    about = {"demonstrations": count, "training_seed": seed, "plain": plain}
    return {**about, "training_cpu_s": spent}


def described(candidate: Candidate, found: list[Rollout]) -> dict[str, Any]:
    """The entry of a candidate."""
    failures = Counter(rollout.reason for rollout in found if not rollout.success)
    rate = trials.success_rate([rollout.success for rollout in found])
    least, most = candidate.asked
    return {
        "name": candidate.name,
        **candidate.facts,
        **rate,
        "asked": [least, most],
        "met": least - 1e-9 <= rate["k"] / rate["n"] <= most + 1e-9,
        "refused": sum(rollout.refused for rollout in found),
        "rcm_max_mm": 1e3 * max(rollout.rcm_max for rollout in found),
        "failures": dict(failures),
    }


def candidates(root: Path, options: argparse.Namespace, progress: Progress) -> list[Candidate]:
    """Demonstrate, export and train."""
    from functools import partial

    shown = root / "demonstrations"
    plan = demonstrations.DemonstrationPlan(shown, cell_files.find(CELL), TASK, shake=options.shake)
    chosen = episode_seeds.training_seeds(options.episodes)
    total = len(chosen)

    def tell(n: int, newest: demonstrations.Demonstration) -> None:
        progress.update(0.4 * n / total, f"{n} of {total} demonstrations, seed {newest.seed}")

    demonstrations.play(plan, chosen, options.jobs, tell)
    progress.update(0.4, "datasets")
    whole = export([shown], root / "dataset")
    few = {
        n: export([plan.folder(seed) for seed in chosen[:n]], root / f"dataset_{n}")
        for n in options.few
        if n <= total
    }
    calm = [plan.folder(seed) for seed in chosen[::2]]  # ``play`` shakes the others
    plain = {
        n: export(calm[:n], root / f"dataset_calm_{n}") for n in options.plain if n <= len(calm)
    }
    found = []
    for n in range(options.seeds):
        progress.update(0.5, f"training {n + 1} of {options.seeds + len(few)}")
        facts = train(whole, root / f"weights_{n}.npz", n)
        make = partial(learned, root / f"weights_{n}.npz")
        name = f"{total} demonstrations, training seed {n}"
        found.append(Candidate(name, make, (0.85, 1.0), facts))
    for n, dataset in few.items():
        progress.update(0.55, f"training with {n} demonstrations")
        facts = train(dataset, root / f"weights_of_{n}.npz", 0)
        make = partial(learned, root / f"weights_of_{n}.npz")
        found.append(Candidate(f"{n} demonstrations", make, facts=facts))
    for n, dataset in plain.items():
        progress.update(0.58, f"copying {n} calm demonstrations plainly")
        facts = train(dataset, root / f"weights_plain_{n}.npz", 0, plain=True)
        make = partial(learned, root / f"weights_plain_{n}.npz")
        # A task that a few copied demonstrations solve would not show what learning is worth.
        asked = (0.0, 0.7 if n <= 10 else 1.0)
        found.append(Candidate(f"{n} calm demonstrations, copied plainly", make, asked, facts))
    found.append(Candidate("holds", Hold, (0.0, 0.0)))
    found.append(Candidate("moves at random", Random, (0.0, 0.0)))
    found.append(Candidate("replays a demonstration", partial(replayed, whole), (0.0, 0.2)))
    return found


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="bench learn", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--episodes", type=int, default=80, help="demonstrations")
    parser.add_argument(
        "--few", type=int, nargs="*", default=[10, 4, 2], help="demonstrations of smaller sets"
    )
    parser.add_argument(
        "--plain", type=int, nargs="*", default=[40, 10], help="calm ones, copied plainly"
    )
    parser.add_argument("--seeds", type=int, default=3, help="training seeds")
    parser.add_argument("--rollouts", type=int, default=20, help="of each policy")
    parser.add_argument("--tuning", action="store_true", help="tuning seeds instead of test seeds")
    parser.add_argument("--shake", type=float, default=0.003, help="as learn's [m]")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--keep", type=Path, metavar="DIR", help="work here, and go on there")
    options = parser.parse_args()
    started, before = time.monotonic(), os.getloadavg()[0]
    root = options.keep or Path(tempfile.mkdtemp(prefix="bench_learn_"))
    root.mkdir(parents=True, exist_ok=True)
    judged = (episode_seeds.tuning_seeds if options.tuning else episode_seeds.test_seeds)(
        options.rollouts
    )
    entries = []
    try:
        with Progress("bench learn") as progress:
            found = candidates(root, options, progress)
            with ProcessPoolExecutor(options.jobs, get_context("fork")) as pool:
                for n, candidate in enumerate(found):
                    progress.update(0.6 + 0.4 * n / len(found), candidate.name)
                    waiting = [pool.submit(judge, candidate.make, seed) for seed in judged]
                    entries.append(described(candidate, [future.result() for future in waiting]))
    finally:
        if options.keep is None:
            shutil.rmtree(root, ignore_errors=True)
    rows = [["policy", "success", "asked", "95 % interval", "refused", "RCM max [mm]"]]
    for e in entries:
        least, most = (100 * share for share in e["asked"])
        asked = f"{least:.0f} to {most:.0f} %" + ("" if e["met"] else ", MISSED")
        interval = f"{100 * e['low']:.1f} to {100 * e['high']:.1f} %"
        counts = [str(e["refused"]), f"{e['rcm_max_mm']:.3f}"]
        rows.append([e["name"], f"{e['k']}/{e['n']}", asked, interval, *counts])
    say(table(rows))
    result = {
        "format": "surg_bench_learn/1",
        "policies": entries,
        "seeds": [judged.start, judged.stop],
        "wall_s": round(time.monotonic() - started, 1),
        "machine": this_machine(before),
    }
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
        say(str(options.json))
    return 0 if all(e["met"] for e in entries) else 1


if __name__ == "__main__":
    sys.exit(main())
