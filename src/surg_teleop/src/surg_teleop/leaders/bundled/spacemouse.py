"""A SpaceMouse: pushing and turning its cap says how fast the tip moves and rolls."""

from __future__ import annotations

from surg_teleop.leaders.evdev.device_host import Host
from surg_teleop.leaders.evdev.device_leader import InputLeader


class SpaceMouse(InputLeader):
    """Nothing moves unless its left button is held (``layouts/spacemouse.yaml``)."""

    mapping = "rate"

    def __init__(
        self,
        name: str = "spacemouse",
        layout: str = "spacemouse",
        device: str = "",
        host: Host | None = None,
    ) -> None:
        """As :class:`InputLeader`; ``spacemouse_relative`` is for models with relative axes."""
        super().__init__(name, layout, device, host)
