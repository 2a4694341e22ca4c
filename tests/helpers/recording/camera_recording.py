"""A recording of one camera unless told otherwise, and waiting for what its encoder does."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from surg_recording.episode.episode_recorder import Recording


def start(
    folder: Path, mode: str = "freerun", arms: Sequence[str] = (), cameras: Sequence[str] = ("cam",)
) -> Recording:
    """Begin it, on a disk as full as it may be."""
    return Recording(folder, mode=mode, arms=arms, cameras=cameras, manifest={}, min_free_bytes=0)


def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition, 20 s at most."""
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
