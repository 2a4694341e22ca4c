"""`./surg recover FOLDER`: finish recordings that a kill or a power cut has left unfinished."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.host.terminal import Problem, Progress, say, warn


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument(
        "folders",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="an unfinished recording (….partial), or a folder with some anywhere below it",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Recover each; exit status 1 when one could not be."""
    from surg_recording.episode import episode_reader, recovery
    from surg_recording.recording_errors import EpisodeError

    found: list[Path] = []
    for folder in options.folders:
        if not folder.is_dir():
            raise Problem(f"recover {folder}: no such folder", 2)
        found += [folder] if folder.name.endswith(episode_reader.PARTIAL) else _below(folder)
    if not found:
        names = ", ".join(map(str, options.folders))
        say(
            f"recover: nothing is unfinished in {names} "
            f"(no folder ends in {episode_reader.PARTIAL})"
        )
        return 0
    failed = 0
    told: list[str] = []
    with Progress("recover") as progress:
        for number, folder in enumerate(found):
            progress.update(number / len(found), str(folder))
            try:
                final = recovery.recover_one(folder.absolute(), recovery.BY_HAND)
                told.append(_summary(final))
            except EpisodeError as problem:
                warn(f"surg: {problem}")
                failed += 1
    for line in told:
        say(line)
    return 1 if failed else 0


def _below(folder: Path) -> list[Path]:
    """Unfinished recordings anywhere below a folder."""
    from surg_recording.episode.episode_reader import PARTIAL

    return sorted(path for path in folder.rglob(f"*{PARTIAL}") if path.is_dir())


def _summary(folder: Path) -> str:
    """What a recovered recording holds, in a line."""
    from surg_recording.episode import episode_reader

    manifest = episode_reader.read(folder).manifest
    rows = sum(int(entry["rows"]) for entry in manifest["tables"].values())
    frames = sum(int(entry["frames"]) for entry in manifest["videos"].values())
    return f"{folder}: {rows} rows, {frames} frames; {manifest['reason']}"
