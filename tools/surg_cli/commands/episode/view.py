"""`./surg episode view EPISODE`: one page with video, tip path, curves and events."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from surg_cli.host import option_types
from surg_cli.host.terminal import CliError, Progress, say, show_page


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    option_types.add_episode(parser)
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="page to write (default: beside the episode)"
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Write the page and open it; the last line printed is its path."""
    from surg_recording.clock import sync_report
    from surg_recording.episode import episode_reader as episodes
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.reports import episode_view

    folder = options.episode
    try:
        recorded = episodes.read(folder)
        out = options.out or folder.absolute().with_name(f"{folder.absolute().name}_view.html")
        if not os.access(out.parent, os.W_OK):
            raise CliError(f"{out.parent}: is not writable; name another file with --out", 2)
        with Progress("view") as progress:
            sync_report.ensure(recorded, lambda words: progress.update(None, words))
            episode_view.write(recorded, out, lambda words: progress.update(None, words))
    except EpisodeError as problem:
        raise CliError(str(problem), 2) from problem
    if not show_page(out.absolute().as_uri()):
        say("view: no display; open this file in a browser")
    say(str(out))
    return 0
