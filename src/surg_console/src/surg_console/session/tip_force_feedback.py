"""The force at the tip as a page plays it: how large, and how old."""

from __future__ import annotations

from typing import Any

SILENT = 0.030
"""[s] Age at which a force is not known any more; a page's tone ends within 40 ms of its age."""


def tip_force_feedback(
    force: float | None, heard: float, now: float, following: bool
) -> dict[str, Any]:
    """What the page is told of the tip.

    Args:
        force: Newest magnitude [N]; None: there is none.
        heard: When it was heard [s].
        now: On the same clock [s].
        following: Whether the tip follows the hand: not clutched, not paused.
    """
    age = max(now - heard, 0.0)
    known = following and force is not None and age <= SILENT
    return {"say": "feel", "tip": force if known else None, "age": round(age, 6)}
