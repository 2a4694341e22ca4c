"""Score cards: any policy on the five tasks, through the model server's gate, in lock-step.

POLICY is one of these:

    expert            the scripted sender, which knows the simulator's truth
    hold              another example of `surg_policy_client.policies`: hold, scripted, skeleton
    'FILE.py WORDS'   a client's program with words of its own, such as --weights best.npz
    ipc://, tcp://    the address at which a policy connects that you have started yourself
    CARD.json         a card that somebody sent; it is checked and shown beside the others

A program runs in a process that reaches nothing but its own files and the wire. Each finished cell
is a file in `--keep`; the same command goes on there. The folder gets `report.html`, and for each
policy `card.json` (`surg_recording.cards.score_card` states its keys).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from machine import this_machine
from policy import card_cell, card_conditions, shut_in
from policy.card_cell import EXPERT, CellJob
from policy.card_conditions import BY_NAME, FULL, QUICK

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress, say, table, warn
from surg_recording import file_io, job_pool
from surg_recording.cards import score_card, score_card_page
from surg_recording.episode import provenance
from surg_recording.job_pool import Executor, JobCallbacks
from surg_recording.recording_errors import EpisodeError
from surg_sim.tasks import episode_seeds, names

EPISODES = {"quick": 3, "full": 20}
"""Of each cell."""
A_CARD = re.compile(r"(?!.*\.py['\"]? ).*\.json")
"""The name of a sent card, not a program whose last word is such a file."""
SERVED = QUICK[0].name
"""The condition that shows what a policy reads."""


@dataclass(frozen=True)
class Entrant:
    """A policy of the card.

    Attributes:
        name: For people, without the machine's folders.
        policy: As `CellJob` has it.
        sha256: Of its files; None: they are not here.
        folder: Of its cells and its card.
    """

    name: str
    policy: str | shut_in.Program
    sha256: str | None
    folder: Path

    def file(self, task: str, condition: str) -> Path:
        """Where a finished cell lies."""
        return self.folder / "cells" / f"{task}-{_plain(condition)}.json"


def entrant(given: str, keep: Path) -> Entrant:
    """A policy by its word.

    Raises:
        CliError: There is no such policy, or it cannot be shut in here.
    """
    if given == EXPERT or re.match(r"\w+://", given):
        return Entrant(given, given, None, keep / _plain(given))
    bundled = re.fullmatch(r"\w+", given)
    found = bundled and importlib.util.find_spec(f"surg_policy_client.policies.{given}")
    if bundled and (found is None or not found.origin):
        raise CliError(f"{given}: no policy; see ./surg dev bench policies --help", 2)
    program = shut_in.Program.of(found.origin if found and found.origin else given, keep)
    if problem := shut_in.problem():
        raise CliError(problem)
    shown = " ".join([program.script.name, *(Path(w).name for w in program.words)])
    digest = program.sha256
    name = given if bundled else shown
    return Entrant(name, program, digest, keep / f"{_plain(program.script.stem)}-{digest[:12]}")


def _plain(words: str) -> str:
    """Words as a part of a file's name."""
    return re.sub(r"\W+", "_", words).strip("_")


def options_of(words: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bench policies",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("policies", nargs="+", metavar="POLICY")
    add("--keep", type=Path, required=True, metavar="DIR", help="go on there")
    add("--full", action="store_true", help="also delays, and shifts of picture, place and look")
    add("--rollouts", type=int, metavar="N", help="of each cell (default: 3; with --full 20)")
    add("--phrase", metavar="WORDS", help="draws held-out seeds; who publishes it spends it")
    add("--only", nargs="*", default=[], metavar="WORD", help="tasks or conditions with it")
    add("--jobs", type=int, help="at a time (default: the machine's cores)")
    add("--executor", type=executor_of, default=Executor(), metavar="processes|dask[:ADDRESS]")
    return parser.parse_args(words)


def executor_of(words: str) -> Executor:
    """Where cells are played, as ``--executor`` names it."""
    kind, _, address = words.partition(":")
    if kind == "dask":
        return Executor("dask", scheduler=address or None)
    if words not in ("process", "processes"):
        raise argparse.ArgumentTypeError(f"{words!r}: allowed are processes and dask[:ADDRESS]")
    return Executor()


class Book:
    """Cells of a card: those in the files of a former call, and those to play.

    Args:
        entrants: Whose.
        seeds: Of each cell.
        platform: What the figures depend on.
    """

    def __init__(
        self, entrants: Sequence[Entrant], seeds: Sequence[int], platform: dict[str, Any]
    ) -> None:
        self.entrants, self._seeds = entrants, tuple(seeds)
        self._same = {"platform": platform, "seeds": list(seeds)}
        self.found: dict[tuple[Path, str, str], dict[str, Any]] = {}

    def look_up(self, one: Entrant, task: str, condition: str) -> bool:
        """Whether a cell was played before, with the same seeds and versions."""
        try:
            kept = file_io.read_json(one.file(task, condition))
            same = {key: kept[key] for key in self._same} == self._same
            if same and kept["policy"] == one.sha256:
                self.found[one.folder, task, condition] = kept["played"]
                return True
        except (EpisodeError, KeyError, TypeError):
            pass  # not there, or no cell: it is played
        return False

    def play(self, wanted: Sequence[tuple[Entrant, str, str]], place: Executor) -> None:
        """Play the cells that are not there yet; each is kept as soon as it is finished."""
        jobs = {
            f"{one.folder.name}-{task}-{condition}": (one, task, condition)
            for one, task, condition in wanted
            if not self.look_up(one, task, condition)
        }
        with Progress("bench policies") as progress:
            ended = 0

            def done(key: str, played: dict[str, Any]) -> None:
                nonlocal ended
                one, task, condition = jobs[key]
                text = json.dumps({**self._same, "policy": one.sha256, "played": played})
                paths.write_text(one.file(task, condition), text + "\n")
                self.found[one.folder, task, condition] = played
                ended += 1
                progress.update(ended / len(jobs), f"{one.name}, {task}, {condition}")

            def lost(key: str, why: str) -> None:
                raise CliError(f"{key}: {why}; the same command goes on")

            # One at a time for an address: there one policy connects.
            for here in (place, replace(place, executor="serial")):
                some = {
                    key: CellJob(one.policy, task, condition, self._seeds)
                    for key, (one, task, condition) in jobs.items()
                    if ("://" in str(one.policy)) == (here is not place)
                }
                job_pool.run(card_cell.play, some, here, JobCallbacks(done, lost))

    def card(self, one: Entrant, kind: str, machine: dict[str, Any]) -> dict[str, Any]:
        """The card of a policy."""
        mine = {key[1:]: played for key, played in self.found.items() if key[0] == one.folder}
        order = [(task, c.name) for task in names() for c in FULL if (task, c.name) in mine]
        if not order:
            known = {"tasks": names(), "conditions": BY_NAME}
            said = "; ".join(f"{what}: {', '.join(each)}" for what, each in known.items())
            raise CliError(
                f"{one.name}: --only leaves no cell; a shift of the picture is played beside "
                f"'{SERVED}', most others with --full; {said}"
            )
        cells = [score_card.cell(t, c, BY_NAME[c].blind, mine[t, c]) for t, c in order]
        about = {
            "name": one.name,
            "sha256": one.sha256,
            "shut_in": isinstance(one.policy, shut_in.Program),
        }
        made = score_card.card(kind, about, self._same["platform"], self._seeds, cells)
        latency = {f"{t}, {c}": mine[t, c]["latency_s"] for t, c in order}
        return {**made, "machine": {**machine, "latency_p50_p99_s": latency}}


def wanted(
    book: Book, kind: str, only: Sequence[str], first: bool
) -> list[tuple[Entrant, str, str]]:
    """Cells of the first round, which shows what the policies read, or of the second."""
    conditions = QUICK if kind == "quick" else FULL
    chosen = []
    for one in book.entrants:
        for task in names():
            found = book.found.get((one.folder, task, SERVED), {"served": []})
            looks = any(s["key"].startswith(card_conditions.IMAGES) for s in found["served"])
            for condition in conditions:
                words = f"{task}, {condition.name}"
                named = not only or any(word in words for word in only)
                if (condition.name == SERVED) is not first or not named:
                    continue
                if one.policy == EXPERT and condition.name != SERVED:
                    continue  # it has no observations
                if condition.applies(task, looks):
                    chosen.append((one, task, condition.name))
    return chosen


def seeds_of(phrase: str | None, count: int) -> Sequence[int]:
    """Public test seeds, or those of a phrase.

    Raises:
        ValueError: There are not so many, or the phrase is empty.
    """
    seeds = episode_seeds.test_seeds(count)
    if phrase is None:
        return seeds
    if not phrase.strip():
        raise ValueError("--phrase: it has no words; anybody could draw its seeds")
    return episode_seeds.held_out_seeds(phrase, count)


def platform() -> dict[str, Any]:
    """What a card depends on beside its policy."""
    known = provenance.versions()
    return {name: known[name] for name in ("software", "mujoco")}


def shown(cards: Sequence[dict[str, Any]]) -> None:
    """The table of the terminal, and blind controls that succeed."""
    rows = [["policy", "task", "condition", "success", "95 % interval", "most frequent failure"]]
    for card in cards:
        for cell in card["cells"]:
            between = f"{100 * cell['low']:.0f} to {100 * cell['high']:.0f} %"
            why = " ".join(max(cell["failures"], key=cell["failures"].get, default="").split())
            count = f"{cell['k']}/{cell['n']}"
            rows.append(
                [card["policy"]["name"], cell["task"], cell["condition"], count, between, why]
            )
            if cell["blind"] and cell["k"]:
                warn(f"a blind control succeeds: {cell['task']}, {cell['condition']}, {count}")
    say(table(rows))


def main(words: Sequence[str] | None = None) -> int:
    """Entry point."""
    options = options_of(words)
    before, kind = os.getloadavg()[0], "full" if options.full else "quick"
    started = time.monotonic()
    try:
        count = EPISODES[kind] if options.rollouts is None else options.rollouts
        seeds = seeds_of(options.phrase, count)
        given = [word for word in options.policies if not A_CARD.fullmatch(word)]
        sent = [Path(word) for word in options.policies if A_CARD.fullmatch(word)]
        others = [file_io.read_json(file) for file in sent]
        for file, card in zip(sent, others, strict=True):
            score_card.check(file, card)
        book = Book([entrant(word, options.keep) for word in given], seeds, platform())
        options.keep.mkdir(parents=True, exist_ok=True)
        for first in (True, False):
            place = replace(options.executor, workers=options.jobs)
            book.play(wanted(book, kind, options.only, first), place)
        machine = {**this_machine(before), "wall_s": round(time.monotonic() - started, 1)}
        versions = provenance.versions()
        cards = [book.card(one, kind, {**machine, "versions": versions}) for one in book.entrants]
        for one, card in zip(book.entrants, cards, strict=True):
            paths.write_text(one.folder / "card.json", json.dumps(card, indent=1) + "\n")
            say(f"{one.folder / 'card.json'}: SHA-256 {card['sha256']}")
        shown([*cards, *others])
        say(str(score_card_page.write([*cards, *others], options.keep)))
    except KeyboardInterrupt:
        say("bench policies: stopped; the same command goes on")
        return 130
    except OSError as problem:
        say(f"bench policies: --keep {options.keep}: {problem}")
        return 2
    except (ValueError, EpisodeError, job_pool.NoExecutor, CliError) as problem:
        say(f"bench policies: {problem}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
