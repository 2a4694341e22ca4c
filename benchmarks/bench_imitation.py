"""Does the image policy of bgr look, and what does it stand: pictures, light, lens, pose, delay.

In process (`surg_sim.envs.policy_rollouts`), on test seeds, each condition of `policy/sights.py`.
Several at a time: `--executor processes`, `dask` (a cluster of its own) or `dask:ADDRESS`.
`--weights` are those of `./surg learn bgr --cameras`. Every finished roll-out is kept in `--keep`;
the same command goes on there. `--json FILE` writes (Wilson's 95 % interval):

    format         "surg_bench_imitation/1"
    machine        {processor, cores, load_before, load_after, date}
    weights        SHA-256 of the weights
    seeds          first and last + 1 of the episodes judged
    conditions     [{name, n, k, low, high, refused, stopped, rcm_max_mm,
                   failures: {reason: count}}]
    act_ms         {p50, p99} CPU time of one answer
    wall_s         of this call

The exit code is 1 if pictures that say nothing (black, frozen, another's) give more than 20 %.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from machine import this_machine
from policy.made_up_clock import Delays, play
from policy.sights import CONDITIONS, Condition, Filter, Replayed, turned

from surg_cli.host import paths
from surg_cli.host.terminal import Progress, say, table
from surg_core.contract import image_key
from surg_recording.job_pool import Ends, NoExecutor, Workplace
from surg_recording.job_pool import run as run_jobs
from surg_recording.reports import trials
from surg_sim.tasks import episode_seeds
from surg_sim.tasks.bgr import bgr_definition

sys.path.insert(0, str(paths.ROOT / "examples/bgr"))
CELL, TASK, SIZE = "sim_two_arms", "bgr", (640, 480)
TARGETS = bgr_definition.TARGETS
PICTURE = image_key("endoscope_left")
OTHER = 500
"""The pictures of another episode are those of the seed so much further."""
MOST_BLIND = 0.2


@dataclass(frozen=True)
class Result:
    """One roll-out."""

    condition: str
    seed: int
    success: bool
    reason: str
    stopped: str  # why the model server stopped the policy; empty: it did not
    refused: int  # by the server's safety controller, or in lock-step by the controller
    rcm_max: float  # [m]
    act_ms: list[float]  # CPU time of answers: median and 99 %


class Through:
    """A policy that gets a view of the endoscope through a filter; the CPU time of its answers."""

    def __init__(self, policy: Any, eye: Filter, view: str) -> None:
        self._policy, self._eye = policy, eye
        self._taken = image_key(f"endoscope_{view}")
        self.spent: list[float] = []
        self.acknowledged = policy.acknowledged

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode."""
        self._policy.reset(instruction, seed)

    def act(self, observation: Any) -> Any:
        """The policy's answer to what it is shown."""
        arrays = dict(getattr(observation, "arrays", observation))
        arrays[PICTURE] = self._eye(arrays.pop(self._taken))
        seen = replace(observation, arrays=arrays) if hasattr(observation, "arrays") else arrays
        before = time.process_time()
        answer = self._policy.act(seen)
        self.spent.append(1e3 * (time.process_time() - before))
        return answer


def scene(condition: Condition) -> Any:
    """The environment of a condition."""
    from surg_sim.envs.surg_env import SurgEnv
    from surg_sim.physics.endoscope_rig import FRAMES

    bgr_definition.TARGETS = condition.targets or TARGETS
    width, height = SIZE
    env = SurgEnv(TASK, CELL, condition.setting, (condition.view,), width, height)
    model = env.session.world.model
    camera = model.camera(FRAMES[condition.view])
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


def watched(env: Any, view: str, seed: int) -> Iterator[np.ndarray]:
    """Pictures of the expert's episode."""
    seen, _ = env.reset(seed=seed)
    done = False
    while not done:
        yield seen["images"][view].copy()
        seen, _, terminated, truncated, _ = env.step(env.expert_action())
        done = terminated or truncated


Job = tuple[str, int, Path]
"""Condition, seed, weights."""


def judge(job: Job) -> Result:
    """One roll-out, in a scene of its own."""
    from bgr_image_policy import ImagePolicy

    from surg_sim.envs.policy_rollouts import roll_out

    name, seed, weights = job
    condition = next(each for each in CONDITIONS if each.name == name)
    env = scene(condition)
    try:
        rng = np.random.default_rng(seed)
        if condition.eye is None:
            eye: Filter = Replayed(list(watched(env, condition.view, seed + OTHER)))
        else:
            eye = condition.eye(rng)
        policy = Through(ImagePolicy.load(weights), eye, condition.view)
        if condition.delays is None:
            done = roll_out(env, policy, seed)
            stopped, refused = "", done.refused
        else:
            done = play(env, policy, Delays(*condition.delays), seed)
            stopped, refused = done.stopped, sum(done.rejected.values())
    finally:
        env.close()
    spent = [round(float(np.percentile(policy.spent, share)), 2) for share in (50, 99)]
    return Result(name, seed, done.success, done.reason, stopped, refused, done.rcm_max, spent)


class Book:
    """Roll-outs that are done, in a file that grows by a line for each."""

    def __init__(self, folder: Path, digest: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = f"rollouts_{digest[:12]}"
        self._file = folder / f"{self.name}.jsonl"
        self.found: dict[tuple[str, int], Result] = {}
        if self._file.exists():
            for line in self._file.read_text("utf-8").splitlines():
                self._keep(Result(**json.loads(line)))

    def _keep(self, result: Result) -> None:
        self.found[result.condition, result.seed] = result

    def add(self, result: Result) -> None:
        """Keep a roll-out."""
        self._keep(result)
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(result)) + "\n")


def described(name: str, found: list[Result]) -> dict[str, Any]:
    """The entry of a condition."""
    failures = Counter(each.stopped or each.reason for each in found if not each.success)
    return {
        "name": name,
        **trials.success_rate([each.success for each in found]),
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
    parser.add_argument("--weights", type=Path, required=True, help="of learn bgr --cameras")
    parser.add_argument("--keep", type=Path, required=True, metavar="DIR", help="go on there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--first", type=int, default=episode_seeds.TEST.start, help="first seed")
    parser.add_argument("--rollouts", type=int, default=10, help="of each condition")
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="in the names")
    parser.add_argument("--jobs", type=int, help="at a time (default: the machine's cores)")
    parser.add_argument(
        "--executor", type=workplace, default=Workplace(), metavar="processes|dask[:ADDRESS]"
    )
    return parser.parse_args()


def workplace(words: str) -> Workplace:
    """Where roll-outs run, as ``--executor`` names it."""
    kind, _, address = words.partition(":")
    if kind == "dask":
        return Workplace("dask", scheduler=address or None)
    if words != "processes":
        raise argparse.ArgumentTypeError(f"{words!r}: allowed are processes and dask[:ADDRESS]")
    return Workplace()


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


def run(jobs: list[Job], book: Book, place: Workplace, play: Callable[[Job], Result]) -> None:
    """Play all, by a function that other processes can import.

    Raises:
        SystemExit: Some have no result; the book holds the others.
    """
    started, before, lost = time.monotonic(), len(book.found), list[str]()
    # On one scheduler a key stands for one roll-out of one policy.
    by_key = {f"{book.name}-{name}-{seed}": (name, seed, file) for name, seed, file in jobs}
    with Progress("bench imitation") as progress:

        def done(_: str, result: Result) -> None:
            book.add(result)
            n = len(book.found) - before
            left = (time.monotonic() - started) / n * (len(jobs) - n)
            note = f"{result.condition}, seed {result.seed}; {left / 60:.0f} min left"
            progress.update(n / len(jobs), note)

        ends = Ends(done, lambda key, why: lost.append(f"{key}: {why}"))
        try:
            run_jobs(play, by_key, place, ends)
        except NoExecutor as problem:
            raise SystemExit(f"bench imitation: {problem}") from None
    if lost:
        raise SystemExit(f"bench imitation: no result of {'; '.join(lost)}")


def shown(entries: list[dict[str, Any]]) -> list[list[str]]:
    """Rows of the table."""
    rows = [["condition", "success", "95 % interval", "refused", "RCM max [mm]"]]
    for e in entries:
        interval = f"{100 * e['low']:.0f} to {100 * e['high']:.0f} %"
        count, far = f"{e['k']}/{e['n']}", f"{e['rcm_max_mm']:.3f}"
        rows.append([e["name"], count, interval, str(e["refused"]), far])
    return rows


def main() -> int:
    """Entry point."""
    from bgr_image_policy import ImagePolicy

    options = options_of()
    started, before = time.monotonic(), os.getloadavg()[0]
    try:
        digest, names = ImagePolicy.load(options.weights).hash, chosen(options.only)
    except (OSError, ValueError) as error:
        raise SystemExit(f"bench imitation: {error}") from None
    seeds = range(options.first, options.first + options.rollouts)
    book = Book(options.keep, digest)
    # Seed by seed: what is stopped early has all conditions alike.
    wanted = [(name, seed) for seed in seeds for name in names]
    missing = [(*each, options.weights.absolute()) for each in wanted if each not in book.found]
    run(missing, book, replace(options.executor, workers=options.jobs), judge)
    entries = [described(name, [book.found[name, seed] for seed in seeds]) for name in names]
    say(table(shown(entries)))
    spent = np.array([book.found[each].act_ms for each in wanted])
    act_ms = {"p50": float(np.median(spent[:, 0])), "p99": float(spent[:, 1].max())}
    say(f"CPU time of an answer: {act_ms['p50']:.1f} ms, largest p99 {act_ms['p99']:.1f} ms")
    result = {
        "format": "surg_bench_imitation/1",
        "weights": digest,
        "seeds": [seeds.start, seeds.stop],
        "conditions": entries,
        "act_ms": act_ms,
        "wall_s": round(time.monotonic() - started, 1),
        "machine": this_machine(before),
    }
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
        say(str(options.json))
    blind = {each.name for each in CONDITIONS if each.blind}
    return 1 if any(e["name"] in blind and e["k"] / e["n"] > MOST_BLIND for e in entries) else 0


if __name__ == "__main__":
    import bench_imitation  # by its name, so that workers can import what they do

    sys.exit(bench_imitation.main())
