"""`./surg calibrate CELL stereo|camera|handeye|live`: collects views from the running system."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from surg_cli.graph.collect import TIMEOUT_S
from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say

HINT_S = 1.0
"""[s] Hints that last less are not printed."""


def calibrate(cell: Any, options: argparse.Namespace, source: str, date: str) -> int:
    """Collect the views of a step and solve it; ``live`` waits for the console's page.

    Args:
        cell: A loaded cell.
        options: ``what`` (a step, or ``live``), ``to``, ``port``, ``lens_state``,
            ``dry_run``.
        source: ``measured`` or ``simulated``.
        date: Of the files.

    Returns:
        The exit code.

    Raises:
        CliError: The step cannot begin, or no view was taken within the timeout.
    """
    from surg_perception.calibration.result_files import Origin
    from surg_perception.collecting.collect_views_node import CollectViews
    from surg_perception.collecting.collector import CalibrationStep
    from surg_perception.collecting.live_calibration import LiveCalibration

    def name_of(step: CalibrationStep) -> str:
        return "camera" if live.eyes == 1 and step is CalibrationStep.STEREO else step.value

    def new_folder(step: CalibrationStep) -> Path:
        if options.to is not None:
            return Path(options.to)
        return paths.run_folder(None) / "views" / name_of(step)

    def origin(step: CalibrationStep, folder: Path) -> Origin:
        return Origin(f"./surg calibrate {cell.folder.name} {name_of(step)} --live", date, source)

    write, left_only = not options.dry_run, options.what == "camera"
    live = LiveCalibration(cell, new_folder, origin, options.lens_state, write, left_only)
    node = CollectViews(live)
    try:
        if options.what == "live":
            say("waiting for the console's page /calibrate; Ctrl-C ends")
        else:
            node.start(CalibrationStep.STEREO if left_only else CalibrationStep(options.what))
            say(f"views -> {live.status.folder}; hold each view still; Ctrl-C ends, views stay")
        return _follow(node, options)
    except (ValueError, OSError) as error:
        raise CliError(f"calibrate {options.what}: {error}; nothing is written", 1) from error
    finally:
        node.close()


def _follow(node: Any, options: argparse.Namespace) -> int:
    """Print what changes until the step is done."""
    printed: tuple[Any, ...] = ()
    hint, since, progress_at = "", time.monotonic(), time.monotonic()
    views, folder = 0, ""
    result: tuple[str, ...] = ()
    while True:
        status = node.turn()
        now = time.monotonic()
        if status.hint != hint:
            hint, since = status.hint, now
        if (status.views, status.folder) != (views, folder):
            views, folder, progress_at = status.views, status.folder, now
            say(f"  {views} of {status.wanted} views, {round(100 * status.progress)} %: {hint}")
            printed = (hint,)
        elif now - since >= HINT_S and printed != (hint,):
            printed = (hint,)
            say(f"  {hint}")
        if status.result != result:
            result = status.result
            for line in result:
                say(line)
        if status.state.value == "done" and options.what != "live":
            say("nothing written (--dry-run)" if options.dry_run else "restart the system")
            return 0
        if options.what != "live" and now - progress_at > TIMEOUT_S:
            raise CliError(
                f"no new view within {TIMEOUT_S:g} s; {views} views are in {folder}. {hint}"
            )
