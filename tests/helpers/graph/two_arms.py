"""A cell with two bundled arms far from each other: for tests of the graph, not of a task."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from surg_cli.host import paths
from surg_description.make_cell import make_cell

ARMS = ("PSM1", "ECM")
_DESCRIPTION = paths.ROOT / "src" / "surg_description"


def write_two_arms(
    folder: Path,
    robots: tuple[str, str] = ("ur5e", "ur5e"),
    limits: Mapping[str, float] | None = None,
) -> Path:
    """Write the cell.

    Args:
        folder: To be made; its name is the cell's name.
        robots: Of PSM1 and ECM.
        limits: Of PSM1, tightened.

    Returns:
        The folder.
    """
    arms = {}
    for i, (arm, robot) in enumerate(zip(ARMS, robots, strict=True)):
        cell = make_cell(
            _DESCRIPTION / "robots" / f"{robot}.yaml",
            folder,
            _DESCRIPTION / "instruments" / "grasper.yaml",
            arm=arm,
        )
        content = yaml.safe_load(cell.read_text("utf-8"))
        content["arms"][arm]["base"]["xyz"] = [0.0, 3.0 * i, 0.0]
        arms.update(content["arms"])
    arms["PSM1"]["limits"] = dict(limits or {})
    content["arms"] = arms
    cell.write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")
    return folder
