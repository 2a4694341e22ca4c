"""Calibration of a cell's endoscope: board, lenses, hand-eye, bases, error of the chain."""

from __future__ import annotations

import argparse
from typing import Any

from surg_cli.host.terminal import CliError, Progress, say

STEPS = ("board", "camera", "stereo", "handeye", "check", "drift")
"""Steps of the endoscope; `bases --by` is one too."""
LIVE = ("stereo", "camera", "handeye")
"""Steps that take views from a running system."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the steps."""
    add = parser.add_argument_group("endoscope").add_argument
    add("--by", choices=("touch", "tip"), help="bases: measure through the endoscope")
    add(
        "--live",
        action="store_true",
        help="stereo, camera, handeye, bases --by: views from the running system",
    )
    add(
        "--board",
        type=_board_size,
        default=(11, 8, 5.0),
        metavar="CxRxMM",
        help="board: columns, rows, side of a square (default 11x8x5)",
    )
    add(
        "--measured",
        type=float,
        metavar="MM",
        help="board: what its ruler of 100 mm measures",
    )
    add("--lens-state", default="", metavar="TEXT", help="stereo: focus and zoom, in words")
    add("--accept", action="store_true", help="drift: correct the calibration by what was seen")


def _board_size(text: str) -> tuple[int, int, float]:
    """Columns, rows and side of a square [mm]."""
    columns, rows, side = [*text.split("x"), "", ""][:3]
    try:
        if text.count("x") == 2:
            return int(columns), int(rows), float(side)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r}; allowed: columns, rows and mm, such as 11x8x5")


def check_live(options: argparse.Namespace, cell: Any) -> None:
    """Refuse options that do not go with ``--live``, or with the endoscope of a loaded cell.

    Raises:
        CliError: The step has no views from a running system, or a folder is stated as well.
    """
    cameras = [arm.instrument.camera for arm in cell.arms.values()]
    frames = max((len(camera.frames) for camera in cameras if camera is not None), default=0)
    if options.what == "stereo" and frames == 1:
        raise CliError("calibrate stereo: the endoscope has one eye; use camera --live", 2)
    if options.what not in (*LIVE, "live") and options.by is None:
        allowed = f"{', '.join(LIVE)}, bases --by touch|tip"
        raise CliError(f"calibrate {options.what}: --live goes with {allowed}", 2)
    if options.source is not None:
        raise CliError("calibrate: --live and --from exclude one another", 2)


def run(cell: Any, options: argparse.Namespace, source: str, date: str) -> None:
    """Do the step ``options.what``.

    Args:
        cell: A loaded cell.
        options: Of the command.
        source: ``measured`` or ``simulated``.
        date: Of the files.

    Raises:
        CliError: The step is refused; nothing was written.
    """
    what = options.what
    if what == "board":
        _board(cell, options)
        return
    if options.accept and what != "drift":
        raise CliError(f"calibrate {what}: --accept goes with drift", 2)
    if what != "check" and options.source is None:
        missing = (
            "EPISODE is missing" if what == "drift" else "FOLDER (of views) is missing, or --live"
        )
        raise CliError(f"calibrate {what}: --from {missing}", 2)
    from surg_perception.calibration.result_files import Origin

    # A path of this machine does not belong into the cell's files.
    words = [what] + ([f"--by {options.by}"] if what == "bases" else [])
    if options.source is not None:
        words.append(f"--from {' '.join(options.source.name.split())}")
    origin = Origin(f"./surg calibrate {cell.folder.name} {' '.join(words)}", date, source)
    write = (not options.dry_run) if what != "drift" else options.accept
    try:
        lines = _solve(cell, options, origin, write)
    except (ValueError, OSError) as error:
        raise CliError(f"calibrate {what}: {error}; nothing is written", 1) from error
    for line in lines:
        say(line)
    if what == "drift" and not write:
        say("the calibration is unchanged; --accept corrects it")
    elif what != "check":
        say("restart the system" if write else "nothing written (--dry-run)")


def _solve(cell: Any, options: argparse.Namespace, origin: Any, write: bool) -> list[str]:
    """Solve a step and write its files; lines for people."""
    from surg_perception.calibration import base_steps, chain_steps, steps

    what, source, folder = options.what, options.source, cell.folder / "calibration"
    if what == "check":
        return list(chain_steps.check(cell, origin.note if write else ""))
    if what == "drift":
        return _drift(cell, source, origin, write)
    if what == "bases":
        return list(base_steps.bases(cell, source, options.by, origin, write)[2])
    if what == "camera":
        return list(steps.camera(folder, source, origin, write)[1])
    if what == "stereo":
        return list(steps.stereo(folder, source, origin, options.lens_state, write)[1])
    return list(steps.handeye(cell, source, origin, write)[1])


def _drift(cell: Any, episode: Any, origin: Any, write: bool) -> list[str]:
    """Watch an episode for parts that moved."""
    from surg_perception.drift import drift_step
    from surg_recording.recording_errors import EpisodeError

    try:
        with Progress("pictures") as progress:
            return list(drift_step.drift(cell, episode, origin, write, progress.update))
    except EpisodeError as error:
        raise CliError(f"calibrate drift: {error}", 2) from error


def _board(cell: Any, options: argparse.Namespace) -> None:
    """Draw the board, and state in the cell how large its squares are."""
    from surg_perception.calibration import board as boards
    from surg_perception.calibration.board_file import write_board
    from surg_perception.calibration.board_pdf import board_pdf

    if options.to is None and options.measured is None:
        raise CliError("calibrate board: --to FILE.pdf or --measured MM is missing", 2)
    try:
        columns, rows, side = options.board
        drawn = boards.Board(columns, rows, 1e-3 * side)
        if options.to is not None:
            if options.to.suffix == ".png":  # for the bench of the simulator
                boards.write_picture(options.to, drawn)
            else:
                options.to.write_bytes(board_pdf(drawn))
            say(f"written: {options.to}; print a PDF at 100 %, glue it on something flat")
        side = drawn.square
        if options.measured is not None:
            side = boards.printed_square(side, options.measured)
        file = cell.folder / "calibration" / "board.yaml"
        write_board(file, boards.Board(drawn.columns, drawn.rows, side, drawn.dictionary))
    except (ValueError, OSError) as error:
        raise CliError(f"calibrate board: {error}", 1) from error
    say(f"written: {file}: squares of {1e3 * side:.3f} mm")
