"""`./surg episode label EPISODES…`: judge, mark and trim recordings in the browser, by keyboard."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import getpass
from pathlib import Path

from surg_cli.host import option_types, paths
from surg_cli.host.terminal import CliError, say, show_page, warn


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("episodes", nargs="*", type=Path, metavar="EPISODES", help="default: all in runs/")
    add("--where", metavar="EXPR", help=option_types.WHERE)
    add("--by", metavar="NAME", help="who labels (default: the user)")


def main(options: argparse.Namespace, command: str) -> int:
    """Serve the pages until Ctrl-C, then say how many episodes have labels."""
    from surg_console.labelling.label_pages import LabelPages
    from surg_console.labelling.label_server import LabelServer
    from surg_recording.episode import labels

    folders = _chosen(options)
    pages = LabelPages(folders, options.by or getpass.getuser())
    server = LabelServer(pages)
    say(f"label: {len(folders)} episodes; Ctrl-C ends. Labels are kept in {labels.LABELS}.")
    say(server.url)
    show_page(server.url)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(server.serve())
    done = sum((folder / labels.LABELS).exists() for folder in folders)
    say(f"label: {done} of {len(folders)} episodes have labels")
    return 0


def _chosen(options: argparse.Namespace) -> list[Path]:
    """The episodes to label.

    Raises:
        CliError: There is none, or the expression is wrong.
    """
    from surg_recording.episode import episode_reader
    from surg_recording.episode.selection import Selection, SelectionError
    from surg_recording.recording_errors import EpisodeError

    try:
        folders = episode_reader.find(options.episodes or [paths.RUNS])
        if options.where is None:
            return folders
        selection, chosen = Selection(options.where), []
        for folder in folders:
            try:
                chosen += [folder] if selection.matches(episode_reader.read(folder)) else []
            except EpisodeError as problem:  # one recording, not the session
                warn(f"surg: left out: {problem}")
    except SelectionError as problem:
        raise CliError(f"--where: {problem}", 2) from None
    except EpisodeError as problem:
        raise CliError(str(problem), 2) from None
    if not chosen:
        raise CliError(f"--where {options.where!r}: none of {len(folders)} episodes fits", 2)
    return chosen
