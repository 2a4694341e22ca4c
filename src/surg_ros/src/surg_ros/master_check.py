"""A node that starts without a ROS master says so."""

from __future__ import annotations

import sys

import rosgraph


def master_is_online(node: str) -> bool:
    """Whether the ROS master answers; if not, stderr states what to do."""
    if rosgraph.is_master_online():
        return True
    uri = rosgraph.get_master_uri()
    print(f"{node}: no ROS master at {uri}; './surg up CELL' starts one", file=sys.stderr)
    return False
