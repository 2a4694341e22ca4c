"""The columns of a commanded arm in observations and actions, by name; numpy only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Array = np.ndarray
STATE, TASK, ACTION = "observation.state", "privileged.task_state", "action"
MOTION = ("x", "y", "z", "roll", "jaw")
"""Columns of the actions of an arm: absolute targets of tip [m], roll and jaw [rad]."""
SET = slice(5, 9)
"""Set-point of tip and roll in `state_columns`."""


def actions_of(arm: str) -> list[str]:
    """Names of an arm's actions."""
    return [f"{arm}/{name}" for name in MOTION]


def arm_of(actions: Sequence[str]) -> str:
    """The arm whose absolute actions these are.

    Raises:
        ValueError: They are others, or of several arms.
    """
    arm = actions[0].partition("/")[0] if actions else ""
    if list(actions) != actions_of(arm):
        raise ValueError(
            f"the actions {', '.join(actions)}; allowed: {', '.join(actions_of(arm or 'PSM1'))} "
            "(a dataset of one arm without a wrist, with absolute actions)"
        )
    return arm


def state_columns(names: Sequence[str], arm: str) -> Array:
    """Columns of tip, roll, jaw and set-point (`SET`) of an arm, (9,).

    Args:
        names: Of the numbers of `observation.state`.
        arm: Name of the arm.

    Raises:
        ValueError: One is missing.
    """
    wanted = [f"{arm}/{n}" for n in ("tip_x", "tip_y", "tip_z", "roll", "jaw")]
    wanted += [f"{arm}/{n}" for n in ("set_x", "set_y", "set_z", "roll_set")]
    return columns_of(STATE, names, wanted)


def columns_of(key: str, names: Sequence[str], wanted: Sequence[str]) -> Array:
    """Where the wanted names stand among those of an observation.

    Raises:
        ValueError: One is missing.
    """
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"{key} has no {', '.join(missing)}; it has {', '.join(names)[:200]}")
    return np.array([list(names).index(name) for name in wanted])
