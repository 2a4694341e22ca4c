"""`./surg episode import rosbag|lerobot SOURCE…`: recordings of other programs as episodes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import CliError, Progress, say, warn

Job = tuple[str, Path, Callable[[Path, Any], Path]]
"""Words for the progress, the episode's folder, and what writes it with a ledger."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = (
        "Exit status: 0 everything was imported, 1 some was refused, 2 all was, or wrong input."
        " docs/reference/imports.md describes the maps."
    )
    add = parser.add_argument
    kinds = "bags of ROS 1 or 2 (either word), or LeRobot data sets 2.1, 3.0"
    add("kind", choices=("rosbag", "rosbag2", "lerobot"), help=kinds)
    add("sources", nargs="+", type=Path, metavar="SOURCE", help="bags, or folders of data sets")
    add("--out", type=Path, required=True, metavar="DIR", help="episodes become DIR/NAME")
    add("--map", type=Path, metavar="FILE", help="YAML: which topic or column is what")
    add("--stamps", choices=("own", "bag"), default="own", help="of a bag: what states the time")
    add("--allow-loss", type=percent, default=1.0, metavar="PERCENT", help="of each stream; 1")
    add("--only", nargs="+", type=int, metavar="N", help="these episodes of a data set")


def main(options: argparse.Namespace, command: str) -> int:
    """Import each; exit status 1 if one was refused, 2 if all were."""
    from surg_recording.file_io import bounded_memory
    from surg_recording.imports.import_page import Account, write_account
    from surg_recording.imports.ledger import Ledger
    from surg_recording.recording_errors import EpisodeError, words_of

    try:
        stated = None if options.map is None else _yaml(options.map)
        read = _sets if options.kind == "lerobot" else _bags
        with bounded_memory():
            jobs = list(read(options, stated))
    except EpisodeError as problem:
        raise CliError(f"import: {problem}", 2) from None
    options.out.mkdir(parents=True, exist_ok=True)
    accounts = []
    with Progress(f"import to {options.out}") as progress:
        for number, (words, folder, write) in enumerate(jobs):
            progress.update(number / len(jobs), words)
            ledger = Ledger(options.allow_loss / 100)
            try:
                if folder.exists():
                    raise EpisodeError(f"{folder}: is there already; name another --out")
                with bounded_memory():
                    accounts.append(Account(words, write(folder, ledger), "", ledger))
            except Exception as problem:  # one recording, not the import
                accounts.append(Account(words, None, words_of(problem, words), ledger))
    page = write_account(options.out, accounts)
    for account in accounts:
        _say(account)
    refused = sum(account.folder is None for account in accounts)
    say(f"import: {len(accounts) - refused} episodes, {refused} refused; {page}")
    return 2 if refused == len(accounts) else min(refused, 1)


def _say(account: Any) -> None:
    """The episode, and what is not in it; or why there is none."""
    if account.folder is None:
        warn(f"  refused: {account.reason}")
        return
    say(f"  {account.folder}")
    for stream, reasons in account.ledger.dropped.items():
        for reason, count in reasons.items():
            warn(f"    {stream}: {count} dropped: {reason}")
    for words in account.ledger.assumed:
        say(f"    assumed: {words}")


def _bags(options: argparse.Namespace, stated: Any) -> Iterator[Job]:
    from surg_recording.imports import bag_map
    from surg_recording.imports.bag_import import import_bag

    chosen = None if stated is None else bag_map.of_yaml(stated)
    for path in options.sources:

        def write(folder: Path, ledger: Any, path: Path = path) -> Path:
            return import_bag(path, folder, chosen, ledger, options.stamps == "own")

        yield str(path), options.out / path.stem, write


def _sets(options: argparse.Namespace, stated: Any) -> Iterator[Job]:
    from surg_recording.imports.lerobot_reader import import_episode
    from surg_recording.imports.lerobot_set import LeRobotData

    for root in options.sources:
        data = LeRobotData(root)
        for episode in options.only or data.numbers:
            name = f"{root.name}_{episode:06d}"

            def write(folder: Path, ledger: Any, data: Any = data, episode: int = episode) -> Path:
                return import_episode(data, episode, folder, stated, ledger)

            yield f"{root}, episode {episode}", options.out / name, write


def percent(words: str) -> float:
    """A share of 0 to 100."""
    value = float(words)
    if not 0 <= value <= 100:
        raise argparse.ArgumentTypeError(f"{words}: allowed: 0 to 100")
    return value


def _yaml(path: Path) -> Any:
    import yaml  # missing before the first setup

    try:
        return yaml.safe_load(path.read_text("utf-8"))
    except (OSError, yaml.YAMLError) as problem:
        raise CliError(f"--map {path}: {problem}", 2) from None
