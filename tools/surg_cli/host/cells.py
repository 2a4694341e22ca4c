"""Finds the cell a command is about, and makes one for a robot from outside the tree."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from surg_cli.host import paths
from surg_cli.host.terminal import CliError

BUNDLED_ROBOTS = {"ur5e": "sim_ur5e", "panda": "sim_panda"}
ROBOTS = paths.ROOT / "src" / "surg_description" / "robots"
INSTRUMENT = paths.ROOT / "src" / "surg_description" / "instruments" / "grasper.yaml"
ARM = "PSM1"
DEPTH_M = 0.120


def find(name: str) -> Path:
    """A cell's folder, by its name in `cells/` or by the path of it or of its `cell.yaml`.

    Raises:
        CliError: There is none; names the bundled ones.
    """
    for candidate in (Path(name), paths.CELLS / name):
        folder = candidate.parent if candidate.name == "cell.yaml" else candidate
        if (folder / "cell.yaml").is_file():
            return folder.resolve()
    known = sorted(path.parent.name for path in paths.CELLS.glob("*/cell.yaml"))
    raise CliError(
        f"no cell {name!r}: neither a folder with a cell.yaml nor one of {', '.join(known)}", 2
    )


def for_robot(robot: str, folder: Path, instrument: Path = INSTRUMENT) -> Path:
    """The cell for `--robot`: a cell, a robot's bundled one, or one made in a folder round a robot.

    A made cell has the robot base at the world's origin, this instrument, and the trocar on the
    shaft at home with the tip 120 mm deep.

    Raises:
        CliError: There is no such robot or cell, or its files are wrong.
    """
    if robot in BUNDLED_ROBOTS and instrument == INSTRUMENT:
        return find(BUNDLED_ROBOTS[robot])
    path = Path(robot)
    described = described_robots()
    if robot in described:
        path = ROBOTS / f"{robot}.yaml"
    elif path.suffix not in (".yaml", ".yml") or path.name == "cell.yaml":
        try:
            return find(robot)
        except CliError as problem:
            known = ", ".join(described)
            raise CliError(
                f"{robot}: neither {known} nor the path of a robot's YAML; {problem}", 2
            ) from None
    if not path.is_file():
        raise CliError(f"{robot}: no such file", 2)
    from surg_description.make_cell import make_cell

    try:
        return make_cell(path.resolve(), folder, instrument.resolve(), DEPTH_M, ARM).parent
    except (ValueError, OSError) as error:
        raise CliError(str(error), 2) from error


def described_robots() -> list[str]:
    """Names of the robots that the platform describes."""
    return sorted(file.stem for file in ROBOTS.glob("*.yaml"))


def chosen_arms(cell: Any, arm: str | None) -> list[str]:
    """Names of a cell's arms, or the one of `--arm`.

    Raises:
        CliError: The cell has no such arm.
    """
    arms = list(cell.arms)
    if arm is None:
        return arms
    if arm not in arms:
        raise CliError(f"--arm {arm}: no such arm; allowed: {', '.join(arms)}", 2)
    return [arm]


def with_drive(cell: Any) -> tuple[str, ...]:
    """Names of the arms whose instrument has a drive of the platform's."""
    named = cell.arms.items()
    return tuple(name for name, arm in named if arm.hardware and arm.hardware.tool_link == "drive")


def load(folder: Path) -> Any:
    """Read and check a cell with everything it names; returns a `surg_core` Cell.

    Raises:
        CliError: Anything in it is wrong: file, key, value, what is allowed.
    """
    import surg_core

    try:
        return surg_core.load_cell(str(folder))
    except surg_core.ConfigError as error:
        raise CliError(f"{error}{_bundled(str(error))}", 2) from error


def _bundled(refused: str) -> str:
    """Where the platform's file of that name is, if a cell names one that is not there."""
    match = re.search(r"'([^']+)': there is no ", refused)
    if match is None:
        return ""
    bundled = ROBOTS.parent / Path(match[1]).parent.name / Path(match[1]).name
    return f": {bundled}" if bundled.is_file() else ""
