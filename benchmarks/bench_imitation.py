"""Do image policies of bgr look, and what do they stand: pictures, light, lens, pose, delay.

In process (`surg_sim.envs.policy_rollouts`), on test seeds, each condition of `policy/sights.py`.
Several at a time: `--executor processes`, `dask` (a cluster of its own) or `dask:ADDRESS`.
`--weights` are those of `./surg learn bgr --cameras`, or of `surg_learn.bgr.train_cloned`;
several are compared on the same seeds. Every finished roll-out is kept in `--keep`; the same
command of the same programs goes on there. `--json FILE` writes (Wilson's 95 % interval):

    format         "surg_bench_imitation/3"
    machine        {processor, cores, load_before, load_after, date}
    seeds          first and last + 1 of the episodes judged
    policies       [{file, weights: SHA-256, method, seed: of the training, pictures,
                   act_ms: {p50, p99} CPU time of one answer, the median of the roll-outs'
                   medians and the largest of their 99 %,
                   conditions: [{name, n, k, low, high, refused, stopped, rcm_max_mm,
                                failures: {reason: count}}]}]
    methods        [{method, files, conditions}]: the same of all policies together that one
                   recipe (method, options, pictures) gave with several seeds; the interval does
                   not know how trainings differ
    wall_s         of this call

The exit code is 1 if pictures that say nothing (black, frozen, another's) give more than 20 %.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from machine import this_machine
from policy.entrants import Entrant, entrant, pictures_of, policy_of
from policy.sights import CONDITIONS, Condition, Filter, Replayed, turned
from result_book import ResultBook

from surg_cli.host import paths
from surg_cli.host.terminal import Progress, say, table
from surg_core.contract import image_key
from surg_recording.job_pool import Executor, JobCallbacks, NoExecutor
from surg_recording.job_pool import run as run_jobs
from surg_recording.metrics.confidence_intervals import success_rate
from surg_sim.tasks import episode_seeds
from surg_sim.tasks.bgr import bgr_definition

CELL, TASK, SIZE = "sim_two_arms", "bgr", (640, 480)
TARGETS = bgr_definition.TARGETS
LEFT = image_key("endoscope_left")
OTHER = 500
"""The pictures of another episode are those of the first seed from so much further on whose place
is another one, for the judge too."""
MOST_BLIND = 0.2
PLAYED = (
    "benchmarks/bench_imitation.py",
    "benchmarks/policy/*.py",
    "cells/sim_two_arms/**/*.yaml",
    "src/surg_core/include/**/*.hpp",
    "src/surg_core/python/**/*.[ch]pp",
    "src/surg_core/python/**/*.py",
    "src/surg_core/src/**/*.[ch]pp",
    "src/surg_description/*/**/*.yaml",
    "src/surg_description/*/**/*.urdf",
    "src/surg_learn/src/surg_learn/bgr/*_networks.py",
    "src/surg_learn/src/surg_learn/bgr/*_network.py",
    "src/surg_learn/src/surg_learn/bgr/*_policy.py",  # not the trainers
    "src/surg_policy_bridge/client/src/**/*.py",
    "src/surg_policy_bridge/src/**/*.py",
    "src/surg_sim/src/**/*.py",
    "src/surg_sim/src/**/*.xml",
)
"""What decides a roll-out beside the weights, in the checkout."""


@dataclass(frozen=True)
class Result:
    """One roll-out."""

    condition: str
    seed: int
    success: bool
    reason: str
    stopped: str  # why the model server stopped the policy; empty: it did not
    refused: int  # by the controller, and in real time before it by the safety controller
    rcm_max: float  # [m]
    act_ms: list[float]  # CPU time of answers: median and 99 %


class Through:
    """A policy that gets views of the endoscope through filters; the CPU time of its answers.

    Args:
        policy: Answers.
        eyes: Filter of each picture that the policy reads, and the view that it is made of.
    """

    def __init__(self, policy: Any, eyes: Mapping[str, tuple[Filter, str]]) -> None:
        self._policy, self._eyes = policy, eyes
        self.spent: list[float] = []
        self._last: Any = None
        self.acknowledged = policy.acknowledged

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode."""
        self._policy.reset(instruction, seed)

    def act(self, observation: Any) -> Any:
        """The policy's answer to what it is shown."""
        arrays = dict(getattr(observation, "arrays", observation))
        shown = {
            key: eye(arrays[image_key(f"endoscope_{view}")])
            for key, (eye, view) in self._eyes.items()
        }
        for _, view in self._eyes.values():
            arrays.pop(image_key(f"endoscope_{view}"), None)
        arrays |= shown
        seen = replace(observation, arrays=arrays) if hasattr(observation, "arrays") else arrays
        before = time.process_time()
        answer = self._policy.act(seen)
        if answer is not None:
            # Steps of before that go on cost nothing, said again or not.
            if self._last is None or not np.shares_memory(answer, self._last):
                self.spent.append(1e3 * (time.process_time() - before))
            self._last = answer
        return answer


def views_of(condition: Condition, pictures: Sequence[str]) -> dict[str, str]:
    """The view that each picture shows that a policy reads: the condition's as the left one."""
    return {key: condition.view if key == LEFT else "right" for key in pictures}


def scene(condition: Condition, views: Sequence[str]) -> Any:
    """The environment of a condition, with these views."""
    from surg_sim.envs.surg_env import SurgEnv
    from surg_sim.physics.endoscope_rig import FRAMES

    bgr_definition.TARGETS = condition.targets or TARGETS
    width, height = SIZE
    env = SurgEnv(
        TASK, CELL, condition.setting, views, width, height, randomization=condition.randomization
    )
    model = env.session.world.model
    for view in views:
        camera = model.camera(FRAMES[view])
        R = matrix(camera.quat)
        camera.pos[:] += R @ [condition.aside, 0.0, 0.0]
        camera.quat[:] = product(camera.quat, turned(condition.turn))
    return env


def matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrix of a quaternion (w, x, y, z)."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion of the turn b, seen in a's frame, and then a."""
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([w, *v])


def watched(env: Any, views: Sequence[str], seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Pictures of the expert's episode, by view."""
    seen, _ = env.reset(seed=seed)
    done = False
    while not done:
        yield {view: seen["images"][view].copy() for view in views}
        seen, _, terminated, truncated, _ = env.step(env.expert_action())
        done = terminated or truncated


def another(env: Any, seed: int) -> int:
    """The seed of an episode whose place is none of this one's."""

    def place(of: int) -> int:
        env.reset(seed=of)
        return int(env.session.task.target)

    own = place(seed)
    return next(s for s in count(seed + OTHER) if abs(place(s) - own) > bgr_definition.RIGHT)


def eyes_of(
    env: Any, condition: Condition, seed: int, shown: Mapping[str, str]
) -> dict[str, tuple[Filter, str]]:
    """Filter and view of each picture that a policy reads; both eyes meet the same."""
    if condition.eye is not None:
        made = condition.eye
        return {key: (made(np.random.default_rng(seed)), view) for key, view in shown.items()}
    kept = list(watched(env, list(shown.values()), another(env, seed)))
    return {key: (Replayed([each[view] for each in kept]), view) for key, view in shown.items()}


Job = tuple[str, int, Path]
"""Condition, seed, weights."""


def judge(job: Job) -> Result:
    """One roll-out, in a scene of its own."""
    from surg_sim.envs.policy_rollouts import roll_out

    name, seed, weights = job
    condition = next(each for each in CONDITIONS if each.name == name)
    learned = policy_of(weights)
    shown = views_of(condition, pictures_of(learned))
    env = scene(condition, tuple(dict.fromkeys(shown.values())))
    try:
        policy = Through(learned, eyes_of(env, condition, seed, shown))
        if condition.delays is None:
            done: Any = roll_out(env, policy, seed)
            stopped, refused = "", done.refused
        else:
            from policy.made_up_clock import Delays, play  # needs the model server's packages

            done = play(env, policy, Delays(*condition.delays), seed)
            stopped, refused = done.stopped, done.refused
    finally:
        env.close()
    spent = [round(float(np.percentile(policy.spent, share)), 2) for share in (50, 99)]
    return Result(name, seed, done.success, done.reason, stopped, refused, done.rcm_max, spent)


@cache
def programs() -> str:
    """SHA-256 of the files of `PLAYED`."""
    found = hashlib.sha256()
    for pattern in PLAYED:
        for file in sorted(paths.ROOT.glob(pattern)):
            found.update(file.read_bytes())
    return found.hexdigest()


class Book(ResultBook[tuple[str, int], Result]):
    """Roll-outs of weights by the programs as they are, by condition and seed.

    Raises:
        ValueError: See `ResultBook`.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        whole = hashlib.sha256(f"{digest} {programs()}".encode()).hexdigest()
        self.name = f"rollouts_{whole[:12]}"
        super().__init__(
            folder / f"{self.name}.jsonl", Result, lambda each: (each.condition, each.seed)
        )


def described(name: str, found: list[Result]) -> dict[str, Any]:
    """The entry of a condition."""
    failures = Counter(each.stopped or each.reason for each in found if not each.success)
    return {
        "name": name,
        **success_rate([each.success for each in found]),
        "refused": sum(each.refused for each in found),
        "stopped": sum(bool(each.stopped) for each in found),
        "rcm_max_mm": 1e3 * max(each.rcm_max for each in found),
        "failures": dict(failures),
    }


def options_of() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bench imitation", description=(__doc__ or "").split("\n")[0]
    )
    about = "of learn bgr --cameras, or of train_cloned.py; several are compared"
    parser.add_argument("--weights", type=Path, nargs="+", required=True, metavar="W", help=about)
    parser.add_argument("--keep", type=Path, required=True, metavar="DIR", help="go on there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--first", type=int, default=episode_seeds.TEST.start, help="first seed")
    parser.add_argument("--rollouts", type=int, default=10, help="of each condition")
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="in the names")
    parser.add_argument("--jobs", type=int, help="at a time (default: the machine's cores)")
    parser.add_argument(
        "--executor", type=executor_of, default=Executor(), metavar="processes|dask[:ADDRESS]"
    )
    return parser.parse_args()


def executor_of(words: str) -> Executor:
    """Where roll-outs run, as ``--executor`` names it."""
    kind, _, address = words.partition(":")
    if kind == "dask":
        return Executor("dask", scheduler=address or None)
    if words not in ("process", "processes"):
        raise argparse.ArgumentTypeError(f"{words!r}: allowed are processes and dask[:ADDRESS]")
    return Executor()


def chosen(words: list[str]) -> list[str]:
    """Names of the conditions that have one of the words; no words: all.

    Raises:
        ValueError: There is none.
    """
    names = [each.name for each in CONDITIONS]
    found = [name for name in names if not words or any(word in name for word in words)]
    if not found:
        raise ValueError(f"no condition has these words; there are: {'; '.join(names)}")
    return found


def run(
    jobs: list[Job], books: Mapping[Path, Book], place: Executor, play: Callable[[Job], Result]
) -> None:
    """Play all, by a function that other processes can import.

    Args:
        jobs: What to play.
        books: Where the results go, by weights.
        place: Where to play.
        play: Plays one.

    Raises:
        SystemExit: Some have no result; the books hold the others.
    """
    started, played, lost = time.monotonic(), list[str](), list[str]()
    # On one scheduler a key stands for one roll-out of one policy.
    by_key = {f"{books[file].name}-{name}-{seed}": (name, seed, file) for name, seed, file in jobs}
    with Progress("bench imitation") as progress:

        def done(key: str, result: Result) -> None:
            file = by_key[key][2]
            books[file].add(result)
            played.append(key)
            n = len(played)
            left = (time.monotonic() - started) / n * (len(jobs) - n)
            what = f"{file.stem}, {result.condition}, seed {result.seed}"
            progress.update(n / len(jobs), f"{what}; {left / 60:.0f} min left")

        ends = JobCallbacks(done, lambda key, why: lost.append(f"{key}: {why}"))
        try:
            run_jobs(play, by_key, place, ends)
        except NoExecutor as problem:
            raise SystemExit(f"bench imitation: {problem}") from None
    if lost:
        raise SystemExit(f"bench imitation: no result of {'; '.join(lost)}")


def rows_of(label: str, conditions: list[dict[str, Any]]) -> list[list[str]]:
    """Rows of the table, of a policy or a method."""
    rows = []
    for e in conditions:
        interval = f"{100 * e['low']:.0f} to {100 * e['high']:.0f} %"
        count, far = f"{e['k']}/{e['n']}", f"{e['rcm_max_mm']:.3f}"
        rows.append([label, e["name"], count, interval, str(e["refused"]), far])
    return rows


HEAD = ["policy", "condition", "success", "95 % interval", "refused", "RCM max [mm]"]


def told(one: Entrant, book: Book, names: list[str], seeds: range) -> dict[str, Any]:
    """The entry of a policy."""
    spent = np.array([book.found[name, seed].act_ms for name in names for seed in seeds])
    return {
        "file": one.weights.name,
        "weights": one.digest,
        "method": one.method,
        "seed": one.seed,
        "pictures": list(one.pictures),
        "act_ms": {"p50": float(np.median(spent[:, 0])), "p99": float(spent[:, 1].max())},
        "conditions": [described(n, [book.found[n, seed] for seed in seeds]) for n in names],
    }


def pooled(
    entrants: list[Entrant], books: Mapping[Path, Book], names: list[str], seeds: range
) -> list[dict[str, Any]]:
    """The entries of the methods, over all their policies."""
    found = []
    for recipe in dict.fromkeys(one.recipe for one in entrants):
        own = [one for one in entrants if one.recipe == recipe]
        results = [books[one.weights].found for one in own]
        conditions = [
            described(name, [each[name, seed] for each in results for seed in seeds])
            for name in names
        ]
        files = [one.weights.name for one in own]
        found.append({"method": own[0].method, "files": files, "conditions": conditions})
    return found


def labels(entrants: Sequence[Entrant]) -> list[str]:
    """For the table; a file's name where method and seed do not tell it from another."""
    said = [one.label for one in entrants]
    return [
        one.label if said.count(one.label) == 1 else f"{one.label}, {one.weights.name}"
        for one in entrants
    ]


def entered(files: Sequence[Path]) -> list[Entrant]:
    """What is compared.

    Raises:
        OSError: A file cannot be read.
        ValueError: It holds no weights that fit, or two hold the same.
    """
    known: dict[str, Entrant] = {}
    for file in files:
        one = entrant(file.absolute())
        if one.digest in known:
            raise ValueError(f"{file} holds the weights of {known[one.digest].weights}")
        known[one.digest] = one
    return list(known.values())


def main() -> int:
    """Entry point."""
    options = options_of()
    started, before = time.monotonic(), os.getloadavg()[0]
    try:
        names, entrants = chosen(options.only), entered(options.weights)
        books = {one.weights: Book(options.keep, one.digest) for one in entrants}
    except (OSError, ValueError) as error:
        raise SystemExit(f"bench imitation: {error}") from None
    seeds = range(options.first, options.first + options.rollouts)
    # Seed by seed: what is stopped early has all conditions and all policies alike.
    wanted = [(name, seed, file) for seed in seeds for name in names for file in books]
    missing = [(name, seed, f) for name, seed, f in wanted if (name, seed) not in books[f].found]
    run(missing, books, replace(options.executor, workers=options.jobs), judge)
    policies = [told(one, books[one.weights], names, seeds) for one in entrants]
    methods = pooled(entrants, books, names, seeds)
    rows = [HEAD]
    for label, entry in zip(labels(entrants), policies, strict=True):
        rows += rows_of(label, entry["conditions"])
    for entry in methods:
        if len(entry["files"]) > 1:
            rows += rows_of(f"{entry['method']}, all {len(entry['files'])}", entry["conditions"])
    say(table(rows))
    for label, entry in zip(labels(entrants), policies, strict=True):
        spent = entry["act_ms"]
        say(f"{label}: CPU time of an answer {spent['p50']:.1f} ms, p99 {spent['p99']:.1f} ms")
    result = {
        "format": "surg_bench_imitation/3",
        "seeds": [seeds.start, seeds.stop],
        "policies": policies,
        "methods": methods,
        "wall_s": round(time.monotonic() - started, 1),
        "machine": this_machine(before),
    }
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
        say(str(options.json))
    blind = {each.name for each in CONDITIONS if each.blind}
    shown = [e for entry in policies for e in entry["conditions"] if e["name"] in blind]
    return 1 if any(e["k"] / e["n"] > MOST_BLIND for e in shown) else 0


if __name__ == "__main__":
    import bench_imitation  # by its name, so that workers can import what they do

    sys.exit(bench_imitation.main())
