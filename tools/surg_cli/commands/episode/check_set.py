"""`./surg episode check DATASET`: what is wrong with a LeRobot data set of anybody."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress, say, warn

SHOWN = 20
"""Findings that the terminal lists; the page has more."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = "Exit status: 0 nothing was found, 1 something was, 2 no such data set."
    parser.add_argument("set", type=Path, metavar="DATASET", help="folder of a LeRobot set")


def main(options: argparse.Namespace, command: str) -> int:
    """Check, write the page, name the first findings."""
    from surg_recording.file_io import bounded_memory
    from surg_recording.imports.lerobot_set import LeRobotData
    from surg_recording.quality import check_page, set_check
    from surg_recording.quality.set_rows import WHOLE
    from surg_recording.recording_errors import EpisodeError

    root, out = options.set, paths.run_folder(None)
    try:
        with bounded_memory(), Progress(f"check {root}") as progress:
            episodes = LeRobotData(root).count
            found = set_check.check(root, progress.update)
    except EpisodeError as problem:
        raise CliError(f"check: {problem}", 2) from None
    out.mkdir(parents=True)
    page = check_page.write(out, root.absolute(), episodes, found)
    for each in found[:SHOWN]:
        whose = "the set" if each.episode == WHOLE else f"episode {each.episode}"
        warn(f"  {whose}: {each.kind}: {each.where}: {each.what}")
    if len(found) > SHOWN:
        warn(f"  and {len(found) - SHOWN} more")
    say(f"check: {episodes} episodes, {len(found)} findings; {page}")
    return 1 if found else 0
