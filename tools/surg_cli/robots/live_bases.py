"""`./surg calibrate CELL bases --by touch|tip --live`: views when a person presses Enter."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say

HELP = "Enter takes a view, u deletes the last one, s solves, Ctrl-C ends (the views stay)"


def calibrate(cell: Any, options: argparse.Namespace, source: str, date: str) -> int:
    """Take views and solve for the base of the second arm.

    Args:
        cell: A loaded cell.
        options: ``by``, ``to``, ``port``, ``dry_run``.
        source: ``measured`` or ``simulated``.
        date: Of the file.

    Returns:
        The exit code.

    Raises:
        CliError: The step cannot begin, or nobody is at the terminal.
    """
    from surg_perception.calibration.result_files import Origin
    from surg_perception.collecting.base_moments_node import BaseMoments
    from surg_perception.collecting.base_views import BaseViews

    note = f"./surg calibrate {cell.folder.name} bases --by {options.by} --live"
    origin, write = Origin(note, date, source), not options.dry_run
    folder = options.to or paths.run_folder(None) / "views" / "bases"
    moments = None
    try:
        views = BaseViews(cell, options.by, Path(folder))
        moments = BaseMoments(cell, views.arms, views.eyes)
        say(f"views -> {views.path}")
        say(HELP)
        while True:
            say(f"  {views.count} of {views.wanted}: {views.request}")
            if not _obey(_word(views), views, moments):
                continue
            solved, lines = views.solve(origin, write)
            for line in lines:
                say(line)
            if solved:
                say("restart the system" if write else "nothing written (--dry-run)")
                return 0
            say("not accepted yet; go on, s solves again")
    except (ValueError, OSError) as error:
        raise CliError(f"calibrate bases: {error}; nothing is written", 1) from error
    finally:
        if moments is not None:
            moments.close()


def _word(views: Any) -> str:
    """What the person types.

    Raises:
        CliError: Nobody does.
    """
    line = sys.stdin.readline()
    if not line:
        raise CliError(
            f"calibrate bases: nobody is at the terminal; {views.count} views are in {views.path}"
        )
    return line.strip().lower()


def _obey(word: str, views: Any, moments: Any) -> bool:
    """Do what was typed; True: it is time to solve."""
    if word == "s":
        return True
    if word == "u":
        say("  the last view is deleted" if views.undo() else "  there is no view to delete")
    elif word:
        say(f"  {word!r}: {HELP}")
    else:
        moment = moments.next()
        why = moment if isinstance(moment, str) else views.take(moment)
        if why:
            say(f"  not taken: {why}")
        return not why and views.count >= views.wanted
    return False
