"""`./surg robot check FILE` and `./surg robot home FILE`: a robot before its first session."""

from __future__ import annotations

import argparse
import math
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_cli.host import cells
from surg_cli.host.terminal import CliError, say, table, warn

if TYPE_CHECKING:
    from surg_sim.placement.chain_check import Difference
    from surg_sim.placement.home_search import Home

SAME_POSITION, SAME_ANGLE = 1e-6, 1e-6
"""Largest difference between chain and simulator [m], [rad]."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options of `robot check` or `robot home`."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="the robot's YAML, a described robot such as ur5e, or a cell: its mounting counts",
    )
    parser.add_argument("--arm", metavar="ARM", help="only this arm of a cell (default: every arm)")
    parser.add_argument(
        "--instrument",
        type=Path,
        metavar="YAML",
        default=cells.INSTRUMENT,
        help="on a robot's flange (default: the bundled grasper)",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Check, or search; exit status 1 if an arm is not ready for a demo."""
    if not options.instrument.is_file():
        raise CliError(f"{options.instrument}: no such file; an instrument's YAML is needed", 2)
    with tempfile.TemporaryDirectory() as folder:
        cell = cells.load(cells.for_robot(options.file, Path(folder) / "cell", options.instrument))
    status = 0
    for name in cells.chosen_arms(cell, options.arm):
        arm = cell.arms[name]
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always", UserWarning)
            found = check_physics(arm)
        for note in notes:
            say(str(note.message))
        problems = _home(arm) if command == "home" else _check(arm, found)
        for problem in problems:
            warn(f"surg: {problem}")
        status |= bool(problems)
    return status


def check_physics(arm: Any) -> Difference:
    """Build the simulator's arm and compare it with the core's chain.

    Raises:
        CliError: MuJoCo refuses a URDF; states why.
    """
    from surg_sim.placement.chain_check import compare

    try:
        return compare(arm)
    except ValueError as error:
        files = f"{arm.urdf_path} with {arm.instrument_urdf}"
        raise CliError(f"{files}: the simulator refuses them: {error}", 2) from error


def _check(arm: Any, found: Difference) -> list[str]:
    from surg_sim.placement.home_search import judge

    robot = arm.robot
    head = ["joint", "home", "range [rad]", "speed [rad/s]", "acceleration [rad/s^2]"]
    rows = [
        [name, f"{home:.3f}", f"{low:.2f} to {high:.2f}", f"{speed:.2f}", f"{acceleration:.1f}"]
        for name, home, low, high, speed, acceleration in zip(
            robot.joint_names,
            robot.home,
            robot.position_min,
            robot.position_max,
            robot.velocity,
            robot.acceleration,
            strict=True,
        )
    ]
    say(table([head, *rows]))
    say(
        f"kinematics: {found.postures} postures against the simulator's: "
        f"{1e9 * found.position:.1f} nm, {1e6 * found.angle:.2f} urad at most"
    )
    problems = []
    if found.position > SAME_POSITION or found.angle > SAME_ANGLE:
        problems.append("the chain is not the simulator's: please report this file")
    home = judge(arm, robot.home)
    if home is None:
        problems.append("from this home the arm cannot reach its workspace")
    else:
        say(sentence(home))
        problems += shortcomings(home)
    if problems:
        return [*problems, "./surg robot home FILE searches for a better home"]
    say("ready: ./surg demo --robot FILE")
    return []


def _home(arm: Any) -> list[str]:
    from surg_sim.placement.home_search import judge, search

    try:
        found = search(arm)
    except ValueError as error:
        return [str(error)]
    present = judge(arm, arm.robot.home)
    if present is not None:
        say(f"present home: {sentence(present)}")
    say(f"found: {sentence(found)}")
    say(f"home: [{', '.join(f'{angle:.3f}' for angle in found.q)}]  # rad, for joints.home")
    return shortcomings(found)


def sentence(home: Home) -> str:
    """The figures of a home."""
    left = home.reserve
    return (
        f"shaft {math.degrees(home.tilt):.0f} deg from vertical; over its workspace and three "
        f"rolls: {left.margin:.2f} rad from a joint limit, {100 * left.speed:.0f} % of joint "
        f"speeds, {100 * left.acceleration:.0f} % of accelerations at tip_acceleration, singular "
        f"value {left.singular:.2f}"
    )


def shortcomings(home: Home) -> list[str]:
    """What docs/guide/adding_a_robot.md asks of a home and this one lacks."""
    return [term.text for term in home.terms if term.share < 1.0]
