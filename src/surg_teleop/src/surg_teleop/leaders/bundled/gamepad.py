"""A gamepad: the sticks say how fast the tip moves, the triggers move the jaw."""

from __future__ import annotations

from surg_teleop.leaders.evdev.device_host import Host
from surg_teleop.leaders.evdev.device_leader import InputLeader


class Gamepad(InputLeader):
    """Nothing moves unless the right shoulder button is held (``layouts/gamepad.yaml``)."""

    mapping = "rate"

    def __init__(
        self,
        name: str = "gamepad",
        layout: str = "gamepad",
        device: str = "",
        host: Host | None = None,
    ) -> None:
        """As :class:`InputLeader`; other pads and other habits are other layouts."""
        super().__init__(name, layout, device, host)
