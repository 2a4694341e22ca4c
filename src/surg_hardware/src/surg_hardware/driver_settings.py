"""With what a driver's process is called."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class DriverSettings:
    """Of one driver; ``realtime`` is the priority, the limits are as in `robot_link.Settings`."""

    address: str
    realtime: int
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    dead_man: float
    stop_deceleration: float
    driver: str = ""
    """What drives the arm: the link's name, or the folder of a driver from elsewhere."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Section ``settings`` of the link's YAML."""

    @staticmethod
    def from_json(text: str) -> DriverSettings:
        """Read what `json.dumps` of the fields has written."""
        given = json.loads(text)
        given["velocity"] = tuple(given["velocity"])
        given["acceleration"] = tuple(given["acceleration"])
        return DriverSettings(**given)
