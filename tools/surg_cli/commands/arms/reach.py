"""`./surg reach CELL`: where tips and shafts can go, before a session."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from surg_cli.host import cells, paths, reach_picture
from surg_cli.host.terminal import CliError, say, table
from surg_core.tip_reach import Reach, reach

SIDES = ("+x", "+x+y", "+y", "-x+y", "-x", "-x-y", "-y", "+x-y")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("cell", metavar="CELL", help="name in cells/, or a folder")
    add("--arm", metavar="ARM", help="only this arm (default: every arm)")
    add("--out", type=Path, metavar="DIR", help="folder for the picture (default: runs/<time>)")


def main(options: argparse.Namespace, command: str) -> int:
    """Sample, draw and tell; exit status 1 where an arm stands too close at home."""
    cell = cells.load(cells.find(options.cell))
    arms = cells.chosen_arms(cell, options.arm)
    try:
        found = [reach(cell, arm) for arm in arms]
    except ValueError as error:
        raise CliError(str(error), 2) from error
    out = paths.run_folder(options.out)
    out.mkdir(parents=True, exist_ok=True)
    picture = out / "reach.png"
    reach_picture.draw(found, picture)
    head = ["arm", "reached", "in all directions", "slowest", "joint reserve", "clearance"]
    say(table([head, *(row(each) for each in found)]))
    for each in found:
        for text in sentences(each):
            say(text)
    say(f"picture: {picture}")
    return 1 if any(_too_close_at_home(each) for each in found) else 0


def row(found: Reach) -> list[str]:
    """One arm in figures."""
    least = _least(found)
    return [
        found.arm,
        f"{100 * found.share(found.free):.0f} %",
        f"to {math.degrees(found.full_to(found.free)):.0f} deg",
        f"{_smallest(found.speed):.2f} m/s",
        f"{_smallest(found.margin):.2f} rad",
        "nothing near" if math.isinf(least) else f"{max(1e3 * least, 0.0):.0f} mm",
    ]


def sentences(found: Reach) -> list[str]:
    """What the figures mean for a session."""
    depths = f"{1e3 * found.depths[0]:.0f} to {1e3 * found.depths[-1]:.0f} mm deep"
    cone = math.degrees(found.tilts[-1])
    lines = []
    gap = found.first_gap(found.reached)
    if gap is None:
        lines.append(
            f"{found.arm}: the tip reaches its whole cone of {cone:.0f} degrees, {depths}."
        )
    else:
        lines.append(
            f"{found.arm}: of its cone of {cone:.0f} degrees, {depths}, the tip reaches "
            f"{100 * found.share(found.reached):.0f} %. The joints end first at {_place(gap)}."
        )
    lines.append(
        f"{found.arm}: {found.nearest_joint} comes nearest to its limit, "
        f"{_smallest(found.margin):.2f} rad."
    )
    if not found.distance:
        lines.append(f"{found.arm}: no clearance guard; nothing else is in the cell.")
        return lines
    own, other = found.nearest
    least = 1e3 * _least(found)
    apart = f"{least:.0f} mm apart" if least > 0.0 else f"they would overlap by {-least:.0f} mm"
    near = f"{own} and {other} come closest, {apart}"
    closed = found.first_gap(found.clearance >= found.distance)
    kept = f"{1e3 * found.distance:.0f} mm"
    if _too_close_at_home(found):
        lines.append(
            f"{found.arm}: it stands closer than {kept} at home: {near}. It may only move away. "
            "Move the base, choose another home, or lower clearance.distance in cell.yaml."
        )
    elif found.share(found.reached & ~found.free) > 0.0 and closed is not None:
        lines.append(
            f"{found.arm}: with the other arms at home {near}. The guard keeps {kept} and stops "
            f"the arm in {100 * found.share(found.reached & ~found.free):.0f} % of what it reaches."
        )
    else:
        lines.append(
            f"{found.arm}: with the other arms at home {near}. The guard keeps {kept} and stops "
            "nothing."
        )
    return lines


def _too_close_at_home(found: Reach) -> bool:
    return bool((found.clearance[0] < found.distance).any())


def _least(found: Reach) -> float:
    return _smallest(found.clearance)


def _smallest(values: object) -> float:
    import numpy as np

    array = np.asarray(values)
    return float(np.nanmin(array)) if not np.isnan(array).all() else math.nan


def _place(gap: tuple[float, float, float]) -> str:
    tilt, turn, depth = gap
    side = SIDES[round(turn / (math.pi / 4)) % len(SIDES)]
    return f"{math.degrees(tilt):.0f} degrees towards {side}, {1e3 * depth:.0f} mm deep"
