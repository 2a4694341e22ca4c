"""What an arm of a cell keeps its distance to: the other arms and the cell's obstacles."""

from __future__ import annotations

from collections.abc import Iterable

from surg_core._core import ArmShape, ClearanceSetup
from surg_core.config import Arm, Cell


def clearance_setup(
    cell: Cell, name: str, others: Iterable[str] | None = None
) -> ClearanceSetup | None:
    """The clearance setup of one arm.

    Args:
        cell: The loaded cell.
        name: The arm.
        others: The other arms that run; None: all of the cell.

    Returns:
        None where there is nothing to keep clear of, and where a robot has no capsules and the cell
        has no ``clearance`` section.

    Raises:
        ConfigError: The cell has a ``clearance`` section and a robot has no capsules.
    """
    stated = cell.config.clearance
    known = [other for other in cell.arms if other != name]
    present = known if others is None else [other for other in known if other in set(others)]
    arms = [cell.arms[each] for each in (name, *present)]
    shapeless = any(not arm.robot.capsules for arm in arms)
    if not (present or stated.obstacles) or (shapeless and not stated.line):
        return None
    own, *rest = [_shape(arm) for arm in arms]
    return ClearanceSetup(stated.distance, stated.shafts, own, rest, stated.obstacles)


def _shape(arm: Arm) -> ArmShape:
    return ArmShape(arm.name, arm.chain, arm.X_WB, arm.robot, arm.instrument, arm.tool)
