"""`./surg episode recover FOLDER`: completes recordings that a kill or a power cut interrupted."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.host.terminal import CliError, Progress, say, warn


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument(
        "folders",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="an interrupted recording (….partial), or a folder with some below it",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Recover each; exit status 1 if one could not be."""
    from surg_recording.episode import episode_reader, recovery
    from surg_recording.recording_errors import EpisodeError

    partial: list[Path] = []
    for folder in options.folders:
        if not folder.is_dir():
            raise CliError(f"recover {folder}: no such folder", 2)
        partial += [folder] if folder.name.endswith(episode_reader.PARTIAL) else _below(folder)
    if not partial:
        names = ", ".join(map(str, options.folders))
        say(
            f"recover: no interrupted recordings in {names} "
            f"(no folder ends in {episode_reader.PARTIAL})"
        )
        return 0
    failed = 0
    lines: list[str] = []
    with Progress("recover") as progress:
        for number, folder in enumerate(partial):
            progress.update(number / len(partial), str(folder))
            try:
                final = recovery.recover_one(folder.absolute(), recovery.BY_HAND)
                lines.append(_summary(final))
            except EpisodeError as problem:
                warn(f"surg: {problem}")
                failed += 1
    for line in lines:
        say(line)
    return 1 if failed else 0


def _below(folder: Path) -> list[Path]:
    """Interrupted recordings anywhere below a folder."""
    from surg_recording.episode.episode_reader import PARTIAL

    return sorted(path for path in folder.rglob(f"*{PARTIAL}") if path.is_dir())


def _summary(folder: Path) -> str:
    """One line on the content of a recovered recording."""
    from surg_recording.episode import episode_reader

    manifest = episode_reader.read(folder).manifest
    rows = sum(int(entry["rows"]) for entry in manifest["tables"].values())
    frames = sum(int(entry["frames"]) for entry in manifest["videos"].values())
    return f"{folder}: {rows} rows, {frames} frames; {manifest['reason']}"
