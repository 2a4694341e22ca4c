"""`./surg episode film EPISODE --out x.mp4`: a short film for papers and talks."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.graph import episode_film
from surg_cli.host import cells, option_types
from surg_cli.host.terminal import CliError, Progress, say


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    option_types.add_episode(parser)
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="FILE", help="x.mp4 (H.264) or x.gif")
    add("--cell", type=Path, metavar="CELL", help="default: the bundled cell of the recording")
    add(
        "--seconds",
        type=option_types.positive,
        default=12.0,
        metavar="S",
        help="longest film; a longer episode is played faster (12 s)",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Write the film; the last line printed is its path."""
    from surg_recording.episode import episode_reader
    from surg_recording.recording_errors import EpisodeError
    from surg_sim.appearance.opengl import NoOpenGL

    try:
        recorded = episode_reader.read(options.episode)
        name = (recorded.manifest.get("cell") or {}).get("name")
        imported = recorded.manifest.get("mode") == "imported"
        if options.cell is None and not (name or imported):
            raise CliError(f"{options.episode}: names no cell; give --cell", 2)
        alone = imported and options.cell is None  # without a cell the cameras alone are shown
        cell = None if alone else cells.find(options.cell or str(name))
        with Progress("film") as progress:
            episode_film.make(recorded, cell, options.out, options.seconds, progress.update)
    except (EpisodeError, NoOpenGL, ValueError) as problem:
        raise CliError(str(problem), 2) from problem
    say(str(options.out))
    return 0
