"""A recorded motion, and a set of them, that a smoothness figure is compared with."""

from __future__ import annotations

import dataclasses

from surg_recording.metrics._types import Array


@dataclasses.dataclass(frozen=True)
class Motion:
    """One tip motion on a uniform grid."""

    name: str
    fs: float
    """[Hz]"""
    p: Array
    """(N, 3) [m]."""
    skill: str | None = None
    """novice, intermediate or expert, if known."""


@dataclasses.dataclass(frozen=True)
class ReferenceSet:
    """Motions of one task by one kind of system."""

    name: str
    source: str
    motions: tuple[Motion, ...]
    warnings: tuple[str, ...]
    """What was left out and why, one sentence each."""
