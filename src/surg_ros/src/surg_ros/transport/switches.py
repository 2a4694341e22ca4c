"""Which transport optimisations are in use; the environment can turn each of them off.

``SURG_PLAIN_ROS=polled_subscriber,direct_publisher ./surg up …`` runs the graph with rospy's own
receive threads and ``publish``; ``SURG_PLAIN_ROS=all`` turns everything off.
"""

from __future__ import annotations

import os

VARIABLE = "SURG_PLAIN_ROS"
NAMES = ("direct_publisher", "polled_subscriber")


def plain(name: str) -> bool:
    """Whether an optimisation of `NAMES` is turned off.

    Raises:
        ValueError: The environment variable names an unknown optimisation.
    """
    words = {word.strip() for word in os.environ.get(VARIABLE, "").split(",")} - {""}
    if unknown := sorted(words - {*NAMES, "all"}):
        raise ValueError(
            f"{VARIABLE}: unknown {', '.join(unknown)}; allowed: {', '.join(NAMES)}, all"
        )
    return name in words or "all" in words
