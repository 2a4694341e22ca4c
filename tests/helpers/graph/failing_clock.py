"""An exception in a node's control loop: a library that tests preload into it."""

from __future__ import annotations

from pathlib import Path

from helpers.graph.preload import library


def environment(trigger: Path) -> dict[str, str]:
    """Environment in which a control loop throws as soon as a file exists.

    Args:
        trigger: The file.
    """
    return {"LD_PRELOAD": library("failing_clock"), "FAILING_CLOCK": str(trigger)}
