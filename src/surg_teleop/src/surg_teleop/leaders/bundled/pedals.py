"""Foot pedals: clutch, camera, operator present. They move nothing themselves."""

from __future__ import annotations

from surg_teleop.leaders.evdev.device_host import Host
from surg_teleop.leaders.evdev.device_leader import InputLeader
from surg_teleop.leaders.leader import LeaderError, LeaderSample


class Pedals(InputLeader):
    """Pedals that are keyboards to the kernel: grabbed, so that they type nowhere.

    A clutch pedal that is not there counts as pressed: the hand is let go, and it is said why.
    """

    def __init__(
        self,
        name: str = "pedals",
        layout: str = "pedals",
        device: str = "",
        host: Host | None = None,
    ) -> None:
        """As :class:`InputLeader`; what your pedals type is a matter of their layout."""
        super().__init__(name, layout, device, host)

    def read(self, now: float) -> LeaderSample:
        """What the feet say now; never silent, never raises."""
        try:
            sample = super().read(now)
        except LeaderError:  # kept in self.lost
            sample = None
        if sample is not None:
            return sample
        why = self.lost or f"{self.name}: not opened; open it first"
        return LeaderSample(stamp=now, buttons=self.layout.fail_pressed, problem=why)
