"""The endoscope of a system in real time: the cell's source of pictures, or the simulator.

Also what is made of its pictures: depth and marks.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

from surg_cli.host.terminal import CliError

EYES = ("left", "right")
WORDS = ("none", "left", "stereo", "depth", "marks")
"""Of `--cameras`."""


@dataclass(frozen=True)
class Endoscope:
    """Views that are published, and the capture node's parameters (None: the simulator's)."""

    views: tuple[str, ...]
    capture: dict[str, object] | None = None


def of_cell(config: Any, simulated: bool, eyes: int, lockstep: bool = False) -> Endoscope:
    """The endoscope of a ``surg_core`` CellConfig.

    Args:
        config: The cell.
        simulated: Whether the simulator drives an arm, so that it can render.
        eyes: Of the simulator's; those of a source are what its layout holds. 0: no endoscope.
        lockstep: Whether time is simulated.

    Raises:
        CliError: A real endoscope in simulated time.
    """
    stated = config.endoscope
    if not eyes:
        return Endoscope(())
    if stated is None:
        return Endoscope(EYES[:eyes] if simulated else ())
    if lockstep:
        raise CliError(
            f"--lock-step: {config.file}: endoscope.source: {stated.source} delivers pictures in "
            "real time; omit --lock-step, or add --cameras none",
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


@dataclass(frozen=True)
class Pictures:
    """What `--cameras` asks for: a number of eyes, and what is made of their pictures."""

    eyes: int
    depth: bool = False
    marks: bool = False

    @property
    def asked(self) -> str:
        """The word that needs two eyes."""
        return "--cameras depth" if self.depth else "--cameras marks"


def pictures(text: str) -> Pictures:
    """The value of `--cameras`, words with commas between them.

    Raises:
        argparse.ArgumentTypeError: A word is unknown, or excludes another.
    """
    words = set(text.split(","))
    if words - set(WORDS) or ("none" in words and len(words) > 1):
        allowed = "none, or left, stereo, depth, marks with commas"
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
    eyes = 0 if "none" in words else 1 if words == {"left"} else 2
    return Pictures(eyes, "depth" in words, "marks" in words)


def add_cameras(parser: argparse.ArgumentParser) -> None:
    """Declare the option of the endoscope's pictures."""
    parser.add_argument(
        "--cameras",
        type=pictures,
        default=Pictures(1),
        metavar="WHAT",
        help="none, left (default), stereo; also depth: rectified pictures, depth and points; "
        "marks: tips, shafts, jaws and trocars by joints alone; several with commas",
    )


def eyes_of(asked: Pictures, scope: Endoscope, cell: Any) -> dict[str, object] | None:
    """Parameters of the node ``/eyes``; None: nobody needs it.

    Both eyes of a calibrated cell are watched for drift.

    Args:
        asked: By `--cameras`.
        scope: The endoscope.
        cell: A loaded cell.

    Raises:
        CliError: There are no two eyes.
    """
    drift = len(scope.views) == len(EYES) and _states_its_errors(cell)
    if not (asked.depth or asked.marks or drift):
        return None
    if len(scope.views) < 2:
        why = "there are no pictures" if not scope.views else "the endoscope has one eye"
        raise CliError(
            f"{asked.asked}: {why}; allowed: a stereo endoscope, such as that of sim_two_arms", 2
        )
    params: dict[str, object] = {"depth": asked.depth, "marks": asked.marks, "drift": drift}
    return {**params, "cell": str(cell.folder)} if asked.marks or drift else params


def _states_its_errors(cell: Any) -> bool:
    """Whether camera and bases of a cell are measured."""
    if not any(cell.folder.glob("calibration/camera_*.yaml")):
        return False
    from surg_core import ConfigError
    from surg_perception.drift.stated_parts import stated_parts

    try:
        return bool(stated_parts(cell))
    except ConfigError:
        return False
