"""Values that the paper publishes (docs/design/paper.md), as marks for figures."""

from __future__ import annotations

from typing import Any


def _mark(metric: str, key: str, of: str, value: float, shift: float = 0.0) -> dict[str, Any]:
    """``value`` of ``metric`` where an entry's ``key`` is ``of``, ``shift`` right of its place."""
    return {"metric": metric, "key": key, "of": of, "value": value, "shift": shift}


_MEAN = -0.42
"""Left of the box of the mean."""
_SIDE = 0.36

PAPER_VALUES = (
    _mark("rcm", "setting", "phantom", 0.035, _MEAN),
    _mark("rcm", "setting", "ex_vivo", 0.052, _MEAN),
    _mark("rcm", "setting", "in_vivo", 0.079, _MEAN),
    _mark("sparc", "setting", "phantom", -2.0, _SIDE),
    _mark("sparc", "setting", "ex_vivo", -2.0, _SIDE),
    _mark("sparc", "setting", "in_vivo", -4.0, _SIDE),
    _mark("sparc", "skill", "expert", -5.0, _SIDE),
    _mark("ldlj", "setting", "phantom", -20.0, _SIDE),
    _mark("ldlj", "setting", "ex_vivo", -20.0, _SIDE),
    _mark("ldlj", "setting", "in_vivo", -22.0, _SIDE),
    _mark("ldlj", "skill", "expert", -27.0, _SIDE),
)
"""Medians of figure 7 [mm], read from its caption; SPARC and LDLJ of figure 6, read from it."""
