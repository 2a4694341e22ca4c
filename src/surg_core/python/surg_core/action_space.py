"""Action spaces: how the numbers of an action say where an arm shall be at the next grid time.

A data set is exported in one of them, and a policy is served in the one that it was trained in.
Each arm has five numbers; the jaw is absolute in all of them. Vectors are in the arm's rcm frame.

========  ==========================================  ==========================================
name      columns                                     meaning
========  ==========================================  ==========================================
absolute  x, y, z, roll, jaw                          tip and roll at the next grid time
relative  dx, dy, dz, droll, jaw                      their change since the command before
velocity  vx, vy, vz, vroll, jaw                      that change per second
joint     yaw, pitch, insertion, roll, jaw            the same tip as joints of the instrument
========  ==========================================  ==========================================

"Relative" refers to the command of the grid time before, not to the measured tip. Summed up from
the set-point at the start of a stream, the changes give the absolute commands again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from surg_core.contract import ACTION_SPACES
from surg_core.transforms import virtual_tip

Array = npt.NDArray[np.float64]

ABSOLUTE, RELATIVE, VELOCITY, JOINT = ACTION_SPACES
MOVED = 4
"""Numbers of an arm's action before the jaw: tip and roll."""


@dataclasses.dataclass(frozen=True)
class ActionSpace:
    """One action space; ``name`` is a key of ``contract.ACTION_SPACES``."""

    name: str = ABSOLUTE

    def __post_init__(self) -> None:
        """Check the name."""
        if self.name not in ACTION_SPACES:
            known = ", ".join(ACTION_SPACES)
            raise ValueError(f"action space {self.name!r}; allowed: {known}")

    def columns(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Names of the columns, such as ``PSM1/dx``."""
        return tuple(f"{arm}/{name}" for arm in arms for name in ACTION_SPACES[self.name])

    def units(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Units of the columns (SI)."""
        return tuple(ACTION_SPACES[self.name].values()) * len(arms)

    def encode(self, targets: Array, before: Array, period: float) -> Array:
        """Actions from absolute commands.

        Args:
            targets: (K, 5 · arms) commands in force at the grid time after each frame.
            before: (K, 5 · arms) commands in force at each frame.
            period: Of the grid [s].

        Returns:
            (K, 5 · arms) numbers in the order of ``columns``.
        """
        rows, last = _by_arm(targets), _by_arm(before)
        actions = rows.copy()
        if self.name in (RELATIVE, VELOCITY):
            actions[..., :MOVED] -= last[..., :MOVED]
        if self.name == VELOCITY:
            actions[..., :MOVED] /= period
        if self.name == JOINT:
            x, y, z = np.moveaxis(rows[..., :3], -1, 0)
            insertion = np.linalg.norm(rows[..., :3], axis=-1)
            pitch = np.arcsin(np.clip(y / insertion, -1.0, 1.0))
            actions[..., :3] = np.stack([np.arctan2(x, z), pitch, insertion], axis=-1)
        return actions.reshape(targets.shape)

    def decode(self, rows: Array, before: Array, period: float) -> Array:
        """Absolute commands from actions for consecutive grid times, the inverse of ``encode``.

        Args:
            rows: (K, 5 · arms) actions.
            before: (5 · arms,) the absolute command of the grid time before the first row.
            period: Of the grid [s].

        Returns:
            (K, 5 · arms) commands.
        """
        actions = _by_arm(rows)
        targets = actions.copy()
        if self.name in (RELATIVE, VELOCITY):
            step = period if self.name == VELOCITY else 1.0
            moved = np.cumsum(actions[..., :MOVED] * step, axis=0)
            targets[..., :MOVED] = _by_arm(before)[..., :MOVED] + moved
        if self.name == JOINT:
            targets[..., :3] = virtual_tip(*np.moveaxis(actions[..., :3], -1, 0))
        return targets.reshape(rows.shape)


def of_columns(columns: Sequence[str], arms: Sequence[str]) -> ActionSpace | None:
    """The action space with these columns for these arms, or None."""
    spaces = map(ActionSpace, ACTION_SPACES)
    return next((space for space in spaces if space.columns(arms) == tuple(columns)), None)


def _by_arm(rows: Array) -> Array:
    """(…, arms, 5) float64."""
    numbers = np.asarray(rows, dtype=np.float64)
    return numbers.reshape(*numbers.shape[:-1], -1, MOVED + 1)
