"""Calibration of a cell's endoscope: board, lenses, hand-eye, bases, error of the chain."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import Problem, say

STEPS = ("board", "stereo", "handeye", "check")
"""Steps of the endoscope; `bases --by` is one too."""


def add_arguments(parser: argparse.ArgumentParser, bases: Any) -> None:
    """Declare the options of the steps."""
    bases.add_argument(
        "--by", choices=("touch", "tip"), help="measure through the endoscope (default: --other)"
    )
    scope = parser.add_argument_group("endoscope")
    scope.add_argument("--out", type=Path, metavar="FILE", help="board: the PDF, or a PNG")
    scope.add_argument("--squares", default="11x8", metavar="CxR", help="board (default 11x8)")
    scope.add_argument("--square", type=float, default=5.0, metavar="MM", help="side (default 5)")
    scope.add_argument(
        "--measured", type=float, metavar="MM", help="what the printed ruler of 100 mm measures"
    )
    scope.add_argument("--lens-state", default="", metavar="TEXT", help="focus and zoom, in words")


def run(cell: Any, options: argparse.Namespace, source: str, date: str) -> None:
    """Do the step ``options.what``.

    Args:
        cell: A loaded cell.
        options: Of the command.
        source: ``measured`` or ``simulated``.
        date: Of the files.

    Raises:
        Problem: The step is refused; nothing was written.
    """
    what = options.what
    if what == "board":
        _board(cell, options)
        return
    if what != "check" and options.source is None:
        raise Problem(f"calibrate {what}: --from FOLDER is missing: the folder of views", 2)
    from surg_perception.calibration import base_steps, steps
    from surg_perception.calibration.result_files import Origin

    # A path of this machine does not belong into the cell's files.
    folder = "" if options.source is None else re.sub(r"\s+", " ", options.source.name)
    origin = Origin(f"./surg calibrate {cell.folder.name} {what} --from {folder}", date, source)
    write = not options.dry_run
    try:
        if what == "check":
            lines, write = base_steps.check(cell), False
        elif what == "bases":
            *_, lines = base_steps.bases(cell, options.source, options.by, origin, write)
        elif what == "stereo":
            folder = cell.folder / "calibration"
            _, lines = steps.stereo(folder, options.source, origin, options.lens_state, write)
        else:
            _, lines = steps.handeye(cell, options.source, origin, write)
    except (ValueError, OSError) as error:
        raise Problem(f"calibrate {what}: {error}; nothing is written", 1) from error
    for line in lines:
        say(line)
    if what != "check":
        say("restart the system" if write else "nothing written (--dry-run)")


def _board(cell: Any, options: argparse.Namespace) -> None:
    """Draw the board, and state in the cell how large its squares are."""
    from surg_perception.calibration import board as boards
    from surg_perception.calibration.board_file import write_board
    from surg_perception.calibration.board_pdf import board_pdf

    if options.out is None and options.measured is None:
        raise Problem("calibrate board: --out FILE.pdf or --measured MM is missing", 2)
    try:
        drawn = boards.Board(*boards.parse_squares(options.squares), 1e-3 * options.square)
        if options.out is not None:
            if options.out.suffix == ".png":  # for the bench of the simulator
                boards.write_picture(options.out, drawn)
            else:
                options.out.write_bytes(board_pdf(drawn))
            say(f"written: {options.out}; print a PDF at 100 %, glue it on something flat")
        side = drawn.square
        if options.measured is not None:
            side = boards.printed_square(side, options.measured)
        file = cell.folder / "calibration" / "board.yaml"
        write_board(file, boards.Board(drawn.columns, drawn.rows, side, drawn.dictionary))
    except (ValueError, OSError) as error:
        raise Problem(f"calibrate board: {error}", 1) from error
    say(f"written: {file}: squares of {1e3 * side:.3f} mm")
