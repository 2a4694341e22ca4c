"""Passivity observer and controller of one axis of a force that is fed back to a hand.

The hand sees a force that answers its own position late: through the network, the robot and the
estimate of the force. Such a loop can give out more energy than it took in, and then it swings. The
observer counts the energy that the hand has put in, exactly, since the force is constant between
two samples:

E(n) = sum over k <= n of  -f(k - 1) (x(k) - x(k - 1))

f is the force on the hand. The controller does three things. It adds damping, -alpha v, whenever
the next step would take more than is there. While the force gives out energy that is not there, its
share falls; it comes back slowly. Below ``floor`` it gives out none at all. Damping alone would
switch the force at every sign of a small, quantised speed, and that noise carries energy, too.

Observer and alpha follow B. Hannaford and J.-H. Ryu, "Time-domain passivity control of haptic
interfaces", IEEE Transactions on Robotics and Automation 18(1), 2002, one step ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

WEAKEN, RECOVER = 0.005, 0.5
"""Time constants with which the share of the wanted force falls and comes back [s]."""


@dataclass
class PassivityChannel:
    """One axis; see the module.

    Attributes:
        largest_damping: Of the controller [N s/m]. The device's mass over it must be long against a
            step, or the damping itself swings.
        largest_force: That is given out [N].
        floor: Energy below which no more is given out [J], negative: what the speed's error costs.
        energy: The observer's count [J].
        position: At the last step [m]; None before the first.
        force: Given out at the last step [N].
        share: Of the wanted force, 0 to 1.
    """

    largest_damping: float
    largest_force: float
    floor: float = -4e-4
    energy: float = 0.0
    position: float | None = None
    force: float = 0.0
    share: float = 1.0

    def step(self, wanted: float, position: float, dt: float) -> float:
        """The force that may be given out until the next step [N].

        Args:
            wanted: Force on the hand [N].
            position: Of the hand [m].
            dt: Time since the last step and until the next one [s].
        """
        way = 0.0 if self.position is None else position - self.position
        self.energy -= self.force * way
        self.position = position
        speed = way / dt
        if self.energy < self.floor / 4 and wanted * way >= 0.0:
            self.share *= max(0.0, 1.0 - dt / WEAKEN)
        else:
            self.share += (1.0 - self.share) * dt / RECOVER
        force = self.share * wanted
        left = self.energy - force * way  # after another step like the last one
        if left < 0.0 and way != 0.0:
            force -= min(-left / (way * speed), self.largest_damping) * speed
        if self.energy < self.floor and force * way > 0.0:
            force = 0.0
        self.force = min(max(force, -self.largest_force), self.largest_force)
        return self.force

    def rest(self, position: float) -> None:
        """Give out no force, not even damping, until the next step; energy is not kept, debt is."""
        if self.position is not None:
            self.energy -= self.force * (position - self.position)
        self.energy = min(self.energy, 0.0)
        self.position, self.force = position, 0.0
