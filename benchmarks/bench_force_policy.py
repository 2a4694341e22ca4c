"""Does a policy of bgr that feels the force pull less: success, peak force, tension.

`surg_learn.bgr.train_state` learns from the same demonstrations with and without
`observation.force`, and with and without the simulator's tension, which no robot measures. The
policies play test seeds in process (`surg_sim.envs.policy_rollouts`). A roll-out is good if it is
solved and the force on the jaws stayed within 2 N in the retraction. Two more roll-outs of each
seed replace the force: by 0 N, and by that of the expert's episode of another seed.

Everything is kept in `--keep`; the same command goes on there. `--json FILE` writes:

    format          "surg_bench_force_policy/1"
    seeds           first and last + 1 of the episodes judged
    demonstrations  number of them
    expert_peak_n   [median, largest] on the same seeds
    trainings       [{forces, tension_read, felt, seed, n, solved, good, peak_n, tension_n,
                    seconds, failures: {reason: count}}], [median, largest] each
    together        the same without seed, over all trainings
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from policy import force_page
from policy.force_cases import Case, Felt, Meter, Result, cases, cores
from publish import publish
from result_book import ResultBook

from surg_cli.host.terminal import Progress
from surg_core.contract import FORCE_KEY, TICK
from surg_learn.recipes import PUSH_M
from surg_sim.tasks import episode_seeds

CELL, TASK, ARM = "sim_two_arms", "bgr", "PSM1"
OTHER = 500
"""The forces of another episode are those of the seed so much further."""
EXPERT = "expert"
SPAWN = get_context("spawn")


def demonstrate(keep: Path, count: int, jobs: int) -> Path:
    """Play the demonstrations and export those that succeeded; returns the dataset."""
    from surg_core.contract import GRID_RATE
    from surg_recording import datasets
    from surg_sim.envs import demonstrations
    from surg_sim.physics import cell_files

    out = keep / "dataset"
    if (out / "surg_export.json").is_file():
        return out
    plan = demonstrations.DemonstrationPlan(
        keep / "demonstrations", cell_files.find(CELL), TASK, shake=PUSH_M
    )
    with Progress("demonstrations") as progress:
        demonstrations.play(
            plan,
            episode_seeds.training_seeds(count),
            jobs,
            lambda n, made: progress.update(n / count, f"seed {made.seed}"),
        )
    splits = {"train": 0.95, "val": 0.05}
    options = datasets.ExportOptions(
        fps=GRID_RATE, splits=splits, keep_parts=True, replace=True, executor="serial"
    )
    report = datasets.load("lerobot").write([plan.out], out, options)
    if not report.ok:
        raise SystemExit(f"bench force_policy: {[*report.errors, *report.refused.values()][:3]}")
    return out


def train(keep: Path, dataset: Path, case: Case) -> None:
    """Train one policy, in a process of its own."""
    from surg_learn.bgr import train_state

    options = train_state.Options(seed=case.seed, forces=case.forces, tension=case.tension)
    policy = train_state.train(train_state.read(dataset, case.forces), options)
    partial = keep / f"partial_{case.weights}"
    policy.save(partial)
    partial.rename(keep / case.weights)


def train_missing(keep: Path, dataset: Path, wanted: list[Case], jobs: int) -> None:
    """Train what is not there yet."""
    missing = {case.weights: case for case in wanted if not (keep / case.weights).exists()}
    with Progress("trainings") as progress, ProcessPoolExecutor(jobs, SPAWN) as pool:
        waiting = [pool.submit(train, keep, dataset, case) for case in missing.values()]
        for n, future in enumerate(as_completed(waiting), 1):
            future.result()
            progress.update(n / len(waiting), "")


class Scripted:
    """The expert as a policy; keeps what it felt."""

    def __init__(self, env: Any) -> None:
        self._env = env
        self.felt: list[np.ndarray] = []

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode."""
        self.felt = []

    def act(self, observation: Any) -> Any:
        """One action."""
        self.felt.append(observation[FORCE_KEY].copy())
        return self._env.expert_action()[None]


def judge(keep: Path, case: Case | None, seeds: list[int]) -> list[Result]:
    """Roll-outs of a case in a process of its own; None: of the expert."""
    from surg_learn.bgr import state_policy
    from surg_sim.envs.policy_rollouts import roll_out
    from surg_sim.envs.surg_env import SurgEnv

    env = SurgEnv(TASK, CELL, forces=True)
    meter, found = Meter(env.session, ARM), []
    for seed in seeds:
        expert = Scripted(env)
        policy: Any = expert
        if case is not None:
            policy = state_policy.Policy.load(keep / case.weights)
            if case.felt == "other":
                roll_out(env, expert, seed + OTHER)
            if case.felt != "true":
                policy = Felt(policy, np.array(expert.felt) if expert.felt else None)
        meter.clear()
        done = roll_out(env, policy, seed)
        found.append(
            Result(
                EXPERT if case is None else case.name,
                seed,
                done.success,
                done.reason,
                meter.peak,
                meter.tension,
                meter.ticks * TICK,
            )
        )
    env.close()
    return found


class Book(ResultBook[tuple[str, int], Result]):
    """Roll-outs by case and seed."""

    def __init__(self, file: Path) -> None:
        super().__init__(file, Result, lambda each: (each.case, each.seed))


def play(
    keep: Path, book: Book, wanted: list[Case | None], seeds: list[int], jobs: int, at_once: int = 5
) -> None:
    """Play what is missing, `at_once` roll-outs in a process."""
    waiting = []
    with (
        Progress("roll-outs") as progress,
        ProcessPoolExecutor(jobs, SPAWN, max_tasks_per_child=1) as pool,
    ):
        for case in wanted:
            name = EXPERT if case is None else case.name
            missing = [seed for seed in seeds if (name, seed) not in book.found]
            for first in range(0, len(missing), at_once):
                waiting.append(pool.submit(judge, keep, case, missing[first : first + at_once]))
        for n, future in enumerate(as_completed(waiting), 1):
            for result in future.result():
                book.add(result)
            progress.update(n / len(waiting), f"{result.case}, seed {result.seed}")


def described(found: list[Result]) -> dict[str, Any]:
    """Figures of roll-outs."""

    def middle_and_most(values: list[float]) -> list[float]:
        return [round(float(np.median(values)), 3), round(max(values), 3)]

    return {
        "n": len(found),
        "solved": sum(each.success for each in found),
        "good": sum(each.good for each in found),
        "peak_n": middle_and_most([each.peak for each in found]),
        "tension_n": middle_and_most([each.tension for each in found]),
        "seconds": middle_and_most([each.time for each in found]),
        "failures": dict(Counter(each.reason for each in found if not each.success)),
    }


def entry(case: Case, found: list[Result]) -> dict[str, Any]:
    """Of a case."""
    said = {"forces": case.forces, "tension_read": case.tension, "felt": case.felt}
    return {**said, "seed": case.seed, **described(found)}


def options_of() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bench force_policy", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--keep", type=Path, required=True, metavar="DIR", help="go on there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--page", action="store_true", help="rewrite docs/results/force_policy.md")
    parser.add_argument("--demonstrations", type=int, default=80)
    parser.add_argument("--trainings", type=int, default=3, help="seeds of each training")
    parser.add_argument("--rollouts", type=int, default=20, help="of each policy")
    parser.add_argument("--jobs", type=int, default=cores())
    return parser.parse_args()


def main() -> int:
    """Entry point."""
    options = options_of()
    keep: Path = options.keep
    keep.mkdir(parents=True, exist_ok=True)
    wanted = cases(range(options.trainings))
    seeds = list(episode_seeds.test_seeds(options.rollouts))
    dataset = demonstrate(keep, options.demonstrations, options.jobs)
    try:
        book = Book(keep / "rollouts.jsonl")
    except ValueError as error:
        raise SystemExit(f"bench force_policy: {error}") from None
    for tension in (False, True):  # what answers the question first
        part = [case for case in wanted if case.tension == tension]
        train_missing(keep, dataset, part, options.jobs)
        play(keep, book, part, seeds, options.jobs)
    play(keep, book, [None], seeds, options.jobs)
    of = {case: [book.found[case.name, seed] for seed in seeds] for case in wanted}
    kinds = list(dict.fromkeys((case.forces, case.tension, case.felt) for case in wanted))
    together = []
    for kind in kinds:
        alike = [case for case in wanted if (case.forces, case.tension, case.felt) == kind]
        together.append(entry(alike[0], [each for case in alike for each in of[case]]))
    expert = described([book.found[EXPERT, seed] for seed in seeds])
    result = {
        "format": "surg_bench_force_policy/1",
        "seeds": [seeds[0], seeds[-1] + 1],
        "demonstrations": options.demonstrations,
        "expert_peak_n": expert["peak_n"],
        "trainings": [entry(case, found) for case, found in of.items()],
        "together": together,
    }
    publish(result, force_page, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
