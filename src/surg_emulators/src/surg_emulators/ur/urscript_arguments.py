"""Arguments of URScript's functions, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.urscript_syntax import ScriptError


def number(value: Any, what: str, least: float = -math.inf, most: float = math.inf) -> float:
    """A finite number within its range.

    Raises:
        ScriptError: It is not; states what it is for and what is allowed.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ScriptError(f"{what} must be a finite number, not {value!r}")
    if not least <= value <= most:
        raise ScriptError(f"{what} {value} must be from {least} to {most}")
    return float(value)


def six(value: Any, what: str) -> list[float]:
    """Six finite numbers.

    Raises:
        ScriptError: They are not.
    """
    if not isinstance(value, list) or len(value) != 6:
        raise ScriptError(f"{what} must be six numbers, not {value!r}")
    return [number(each, what) for each in value]


def matrix(pose: Any) -> dh.Matrix:
    """The matrix (4, 4) of a pose."""
    return dh.pose_matrix(six(pose, "a pose"))


def close(now: Sequence[float], goal: Sequence[float], scale: float) -> bool:
    """Whether values are at their goal, which the speed scaling may shrink."""
    return all(abs(a - scale * b) < 1e-6 for a, b in zip(now, goal, strict=True))


def cycles(t: Any) -> int:
    """Cycles of a time [s], at least one."""
    return max(1, round(number(t, "time", 0.0, 1e6) / DT))
