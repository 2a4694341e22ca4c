"""The endoscope of a system in real time: the cell's source of pictures, or the simulator.

Also what is made of its pictures: depth and marks.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import Problem

EYES = ("left", "right")


@dataclass(frozen=True)
class Endoscope:
    """Views that are published, and the capture node's parameters (None: the simulator's)."""

    views: tuple[str, ...]
    capture: dict[str, object] | None = None


def of_cell(config: Any, simulated: bool, stereo: bool, lockstep: bool = False) -> Endoscope:
    """The endoscope of a ``surg_core`` CellConfig.

    Args:
        config: The cell.
        simulated: Whether the simulator drives an arm, so that it can render.
        stereo: Both eyes of the simulator's; those of a source are what its layout holds.
        lockstep: Whether time is simulated.

    Raises:
        Problem: A real endoscope in simulated time.
    """
    stated = config.endoscope
    if stated is None:
        return Endoscope(EYES[: 1 + stereo] if simulated else ())
    if lockstep:
        raise Problem(
            f"--lock-step: {config.file}: endoscope.source: {stated.source} delivers pictures in "
            "real time; omit --lock-step, or add --no-video",
            2,
        )
    width, height = stated.size
    params: dict[str, object] = {
        "source": stated.source,
        "layout": stated.layout,
        "width": width,
        "height": height,
        "rate": stated.rate,
        "swap": stated.swap,
        "flip": stated.flip,
        "latency": stated.latency,
    }
    return Endoscope(EYES[: 1 + (stated.layout != "mono")], params)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of what is made of the pictures."""
    parser.add_argument(
        "--depth", action="store_true", help="publish rectified pictures, depth and points"
    )
    parser.add_argument(
        "--marks",
        action="store_true",
        help="publish pictures with tips, shafts, jaws and trocars drawn in, by joints alone",
    )


def eyes_of(options: argparse.Namespace, scope: Endoscope, cell: Path) -> dict[str, object] | None:
    """Parameters of the node ``/eyes``; None: nobody asked for it.

    Raises:
        Problem: There are no two eyes.
    """
    if not (options.depth or options.marks):
        return None
    asked = "--depth" if options.depth else "--marks"
    if len(scope.views) < 2:
        why = "there are no pictures" if not scope.views else "the endoscope has one eye"
        raise Problem(
            f"{asked}: {why}; allowed: a stereo endoscope, such as that of sim_two_arms, without "
            "--no-video",
            2,
        )
    params: dict[str, object] = {"depth": options.depth, "marks": options.marks}
    return {**params, "cell": str(cell)} if options.marks else params
