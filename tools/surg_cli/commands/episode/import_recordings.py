"""`./surg episode import rosbag|lerobot SOURCE…`: recordings of other programs as episodes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import CliError, Progress, say, warn

Job = tuple[str, Path, Callable[[Path], Path]]
"""Words for the progress, the episode's folder, and what writes it."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = (
        "Exit status: 0 everything was imported, 1 some was refused, 2 wrong input."
        " docs/reference/imports.md describes the maps."
    )
    add = parser.add_argument
    add("kind", choices=("rosbag", "lerobot"), help="bags of ROS 1, or LeRobot data sets 2.1, 3.0")
    add("sources", nargs="+", type=Path, metavar="SOURCE", help="bags, or folders of data sets")
    add("--out", type=Path, required=True, metavar="DIR", help="episodes become DIR/NAME")
    add("--map", type=Path, metavar="FILE", help="YAML: which topic or column is what")
    add("--only", nargs="+", type=int, metavar="N", help="these episodes of a data set")


def main(options: argparse.Namespace, command: str) -> int:
    """Import each; exit status 1 if one was refused."""
    from surg_recording.recording_errors import EpisodeError, words_of

    try:
        stated = None if options.map is None else _yaml(options.map)
        jobs = list(_bags(options, stated) if options.kind == "rosbag" else _sets(options, stated))
    except EpisodeError as problem:
        raise CliError(f"import: {problem}", 2) from None
    options.out.mkdir(parents=True, exist_ok=True)
    refused, made = [], []
    with Progress(f"import to {options.out}") as progress:
        for number, (words, folder, write) in enumerate(jobs):
            progress.update(number / len(jobs), words)
            try:
                if folder.exists():
                    raise EpisodeError(f"{folder}: is there already; name another --out")
                made.append(write(folder))
            except Exception as problem:  # one recording, not the import
                refused.append(words_of(problem, words))
    for folder in made:
        say(f"  {folder}")
    for reason in refused:
        warn(f"  refused: {reason}")
    say(f"import: {len(made)} episodes, {len(refused)} refused")
    return 1 if refused else 0


def _bags(options: argparse.Namespace, stated: Any) -> Iterator[Job]:
    from surg_recording.imports import bag_map
    from surg_recording.nodes.bag_import_node import import_bag

    chosen = None if stated is None else bag_map.of_yaml(stated)
    for path in options.sources:
        yield str(path), options.out / path.stem, _writer(import_bag, path, chosen)


def _sets(options: argparse.Namespace, stated: Any) -> Iterator[Job]:
    from surg_recording.imports.lerobot_reader import LeRobotData, import_episode

    for root in options.sources:
        data = LeRobotData(root)
        for episode in options.only or range(data.count):
            name = f"{root.name}_{episode:06d}"

            def write(folder: Path, data: Any = data, episode: int = episode) -> Path:
                return import_episode(data, episode, folder, stated)

            yield f"{root}, episode {episode}", options.out / name, write


def _writer(import_one: Any, path: Path, chosen: Any) -> Callable[[Path], Path]:
    return lambda folder: Path(import_one(path, folder, chosen))


def _yaml(path: Path) -> Any:
    import yaml  # missing before the first setup

    try:
        return yaml.safe_load(path.read_text("utf-8"))
    except (OSError, yaml.YAMLError) as problem:
        raise CliError(f"--map {path}: {problem}", 2) from None
