"""A cell with two bundled arms far from each other: for tests of the graph, not of a task."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from surg_cli.host import paths
from surg_description.make_cell import ArmPlan, make_cell_of

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
    grasper = _DESCRIPTION / "instruments" / "grasper.yaml"
    tightened = {"PSM1": {name: (value, "") for name, value in (limits or {}).items()}}
    plans = {
        arm: ArmPlan(
            _DESCRIPTION / "robots" / f"{robot}.yaml",
            grasper,
            base_xyz=(0.0, 3.0 * i, 0.0),
            limits=tightened.get(arm, {}),
        )
        for i, (arm, robot) in enumerate(zip(ARMS, robots, strict=True))
    }
    return make_cell_of(folder, plans).parent
