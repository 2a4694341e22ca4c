"""Foot pedals: clutch, camera, operator present. They move nothing themselves."""

from __future__ import annotations

from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.leaders.evdev.device_leader import InputLeader
from surg_teleop.leaders.leader import LeaderError


class Pedals(InputLeader):
    """Pedals that are keyboards to the kernel: grabbed, so that they type nowhere.

    A missing clutch pedal counts as pressed: the arm is let go, and the operator is told why.
    """

    kind = "pedals"

    def read(self, now: float) -> LeaderSample:
        """The pressed pedals; never silent, never raises."""
        try:
            sample = super().read(now)
        except LeaderError:  # kept in self.lost
            sample = None
        if sample is not None:
            return sample
        why = self.lost or f"{self.name}: not opened; open it first"
        return LeaderSample(stamp=now, buttons=self.layout.fail_pressed, problem=why)
