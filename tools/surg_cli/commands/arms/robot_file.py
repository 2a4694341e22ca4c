"""`./surg robot check FILE` and `./surg robot home FILE`: a robot's YAML before its first cell."""

from __future__ import annotations

import argparse
import math
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say, table, warn

if TYPE_CHECKING:
    from surg_sim.placement.chain_check import Difference
    from surg_sim.placement.home_search import Home

DEPTH = 0.120
"""Of the tip behind the trocar at home [m]."""
SEED = 0
"""Of the search."""
LEAST_SINGULAR = 0.1
"""Smallest singular value of the flange Jacobian of a good home."""
SAME_POSITION, SAME_ANGLE = 1e-6, 1e-6
"""Largest difference between chain and simulator [m], [rad]."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options of `robot check` or `robot home`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the robot's YAML")
    parser.add_argument(
        "--instrument",
        type=Path,
        metavar="YAML",
        default=paths.ROOT / "src" / "surg_description" / "instruments" / "grasper.yaml",
        help="on its flange (default: the bundled grasper)",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Check, or search; exit status 1 if the robot is not ready for a demo."""
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always", UserWarning)
        arm = _load(options.file, options.instrument)
        found = check_physics(arm)
    for note in notes:
        say(str(note.message))
    if command == "home":
        return _home(arm)
    return _check(arm, found)


def _load(file: Path, instrument: Path) -> Any:
    """The robot as the only arm of a temporary cell."""
    import surg_core
    from surg_description.make_cell import make_cell

    for path in (file, instrument):
        if not path.is_file():
            raise CliError(f"{path}: no such file; the path of a YAML is needed", 2)
    try:
        with tempfile.TemporaryDirectory() as folder:
            make_cell(file.absolute(), Path(folder) / "cell", instrument.absolute(), DEPTH, "PSM1")
            return surg_core.load_cell(Path(folder) / "cell").arms["PSM1"]
    except ValueError as error:  # a ConfigError is one
        raise CliError(str(error), 2) from error


def check_physics(arm: Any) -> Difference:
    """Build the simulator's arm and compare it with the core's chain.

    Raises:
        CliError: MuJoCo refuses the URDF; states why.
    """
    from surg_sim.placement.chain_check import compare

    try:
        return compare(arm)
    except ValueError as error:
        raise CliError(f"{arm.urdf_path}: the simulator refuses it: {error}", 2) from error


def _check(arm: Any, found: Difference) -> int:
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
        problems.append("from this home the arm cannot reach its workspace of 70 x 70 x 60 mm")
    else:
        say(sentence(home))
        problems += shortcomings(home)
    for problem in problems:
        warn(f"surg: {problem}")
    if problems:
        warn("surg: ./surg robot home FILE searches for a better home")
        return 1
    say("ready: ./surg demo --robot FILE")
    return 0


def _home(arm: Any) -> int:
    from surg_sim.placement.home_search import judge, search

    found = search(arm, SEED)
    if found is None:
        warn(
            "surg: no posture holds the workspace of 70 x 70 x 60 mm with the shaft down: the arm "
            "is too short, its limits are too tight, or the instrument points elsewhere"
        )
        return 1
    present = judge(arm, arm.robot.home)
    if present is not None:
        say(f"present home: {sentence(present)}")
    say(f"found: {sentence(found)}")
    say(f"home: [{', '.join(f'{angle:.3f}' for angle in found.q)}]  # rad, for joints.home")
    problems = shortcomings(found)
    for problem in problems:
        warn(f"surg: {problem}")
    return 1 if problems else 0


def sentence(home: Home) -> str:
    """The figures of a home."""
    left = home.reserve
    return (
        f"shaft {math.degrees(home.tilt):.0f} deg from vertical; over 70 x 70 x 60 mm and three "
        f"rolls: {left.margin:.2f} rad from a joint limit, {100 * left.speed:.0f} % of joint "
        f"speeds, {100 * left.acceleration:.0f} % of accelerations at tip_acceleration, singular "
        f"value {left.singular:.2f}"
    )


def shortcomings(home: Home) -> list[str]:
    """What docs/guide/adding_a_robot.md asks of a home and this one lacks."""
    from surg_sim.placement.home_search import LEAST_MARGIN, MOST_TILT

    left, found = home.reserve, []
    if home.tilt > MOST_TILT:
        found.append(
            f"the shaft is {math.degrees(home.tilt):.0f} deg from vertical; allowed are "
            f"{math.degrees(MOST_TILT):.0f}"
        )
    if left.margin < LEAST_MARGIN:
        found.append(
            f"a joint comes within {left.margin:.2f} rad of its limit; {LEAST_MARGIN} are needed"
        )
    if left.singular < LEAST_SINGULAR:
        found.append(f"singular value {left.singular:.2f}; {LEAST_SINGULAR} is needed")
    if left.speed > 1.0:
        found.append(f"{100 * left.speed:.0f} % of a joint's speed at 0.12 m/s and 1 rad/s")
    return found
