"""Do image policies of bgr look, and what do they stand: pictures, light, lens, pose.

In process (`surg_sim.envs.policy_rollouts`), on test seeds, each condition of `policy/sights.py`.
Several at a time: `--executor processes`, `dask` (a cluster of its own) or `dask:ADDRESS`.
`--weights` are those of `./surg learn bgr --cameras keypoints`, or of `train_cloned`;
several are compared on the same seeds. Every finished roll-out is kept in `--keep`; the same
command goes on there. Another version of the programs needs another folder. `--json FILE` writes
(Wilson's 95 % interval):

    format         "surg_bench_imitation/4"
    machine        {processor, cores, load_before, load_after, date}
    seeds          first and last + 1 of the episodes judged
    policies       [{file, weights: SHA-256, method, seed: of the training, pictures,
                   conditions: [{name, n, k, low, high, refused, rcm_max_mm,
                                failures: {reason: count}}]}]
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from machine import this_machine
from policy.entrants import Entrant, entrant
from policy.judge import Job, Result, judge
from policy.sights import CONDITIONS

from surg_cli.host.terminal import Progress, say, table
from surg_recording.job_pool import Executor, JobCallbacks, NoExecutor
from surg_recording.job_pool import run as run_jobs
from surg_recording.metrics.confidence_intervals import success_rate
from surg_sim.tasks import episode_seeds

MOST_BLIND = 0.2


class Book:
    """Roll-outs of weights, in a file that grows by a line for each.

    Args:
        folder: Of the file; a last line that was cut off is played again.
        digest: Of the weights.

    Attributes:
        found: Results by condition and seed.

    Raises:
        ValueError: A line of the file is no result; with file and line.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = f"rollouts_{digest[:12]}"
        self._file = folder / f"{self.name}.jsonl"
        self.found: dict[tuple[str, int], Result] = {}
        text = self._file.read_text("utf-8") if self._file.exists() else ""
        whole, _, rest = text.rpartition("\n")
        if rest:
            self._file.write_text(whole + "\n" if whole else "", "utf-8")
        for n, line in enumerate(whole.splitlines(), 1):
            try:
                self._keep(Result(**json.loads(line)))
            except (ValueError, TypeError) as error:
                raise ValueError(f"{self._file}:{n}: no roll-out ({error}); remove it") from None

    def _keep(self, result: Result) -> None:
        self.found[result.condition, result.seed] = result

    def add(self, result: Result) -> None:
        """Keep a result."""
        self._keep(result)
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(result)) + "\n")


def described(name: str, found: list[Result]) -> dict[str, Any]:
    """The entry of a condition."""
    failures = Counter(each.reason for each in found if not each.success)
    return {
        "name": name,
        **success_rate([each.success for each in found]),
        "refused": sum(each.refused for each in found),
        "rcm_max_mm": 1e3 * max(each.rcm_max for each in found),
        "failures": dict(failures),
    }


def options_of() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bench imitation", description=(__doc__ or "").split("\n")[0]
    )
    about = "of learn bgr --cameras keypoints, or of train_cloned.py; several are compared"
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
    """Rows of the table, of a policy."""
    rows = []
    for e in conditions:
        interval = f"{100 * e['low']:.0f} to {100 * e['high']:.0f} %"
        count, far = f"{e['k']}/{e['n']}", f"{e['rcm_max_mm']:.3f}"
        rows.append([label, e["name"], count, interval, str(e["refused"]), far])
    return rows


HEAD = ["policy", "condition", "success", "95 % interval", "refused", "RCM max [mm]"]


def told(one: Entrant, book: Book, names: list[str], seeds: range) -> dict[str, Any]:
    """The entry of a policy."""
    return {
        "file": one.weights.name,
        "weights": one.digest,
        "method": one.method,
        "seed": one.seed,
        "pictures": list(one.pictures),
        "conditions": [described(n, [book.found[n, seed] for seed in seeds]) for n in names],
    }


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
    rows = [HEAD]
    for label, entry in zip(labels(entrants), policies, strict=True):
        rows += rows_of(label, entry["conditions"])
    say(table(rows))
    result = {
        "format": "surg_bench_imitation/4",
        "seeds": [seeds.start, seeds.stop],
        "policies": policies,
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
