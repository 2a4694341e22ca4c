"""A `cyclonedds` with DDS Security: PyPI's, with a libddsc that was built with it."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path

import pytest

from helpers.graph.ros import RosGraph

VARIABLE = "SURG_CYCLONEDDS_SECURE"
ASK = (
    "missing: Cyclone DDS 11.0.1 with ENABLE_SECURITY: build github.com/eclipse-cyclonedds/"
    f"cyclonedds and name the folder of its libraries in {VARIABLE}"
)
DEBIAN = "/usr/lib/x86_64-linux-gnu/libddsc0debian"
"""Plug-ins of Debian's Cyclone DDS, with which rmw_cyclonedds is built."""


def environment(graph: RosGraph) -> dict[str, str]:
    """Of a process that has it, as docs/guide/coming_from_ros2.md says; else a skip."""
    built = Path(os.environ.get(VARIABLE, "") or "/nonexistent")
    (library,) = list(built.glob("libddsc.so.11.0.1")) or pytest.skip(ASK)
    found = importlib.util.find_spec("cyclonedds")  # not imported: without it the test skips
    assert found is not None and found.origin is not None
    packages = Path(found.origin).parents[1]
    mine = graph.folder / "secure"
    for name in ("cyclonedds", "cyclonedds.libs"):
        shutil.copytree(packages / name, mine / name)
    (theirs,) = (mine / "cyclonedds.libs").glob("libddsc-*")
    shutil.copy(library, theirs)
    path = os.environ.get("LD_LIBRARY_PATH", "")
    return {
        "PYTHONPATH": f"{mine}:{graph.env.get('PYTHONPATH', '')}",
        "LD_LIBRARY_PATH": f"{built}:{path}",
    }
