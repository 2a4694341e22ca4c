"""What leaders on event devices have in common: find, read, notice the loss, come back."""

from __future__ import annotations

import math

from surg_teleop.leaders.evdev.device_hand import Hand, Joy
from surg_teleop.leaders.evdev.device_host import Device, EvdevHost, Host
from surg_teleop.leaders.evdev.device_layout import Layout, read_layout
from surg_teleop.leaders.evdev.device_search import find
from surg_teleop.leaders.evdev.input_events import Decoder
from surg_teleop.leaders.leader import LeaderError, LeaderSample

LOOK_EVERY = 0.5
"""[s] How often a device that has gone is looked for, ..."""
LOOK_FOR = 3.0
"""[s] ... for that long after the list of nodes has changed: udev gives the permission after the
node, and devices that do not fit are left in peace."""


class InputLeader:
    """A leader on one event device.

    The device that has gone is looked for and taken up again. Its hand then starts anew: what is
    held down when it is plugged in counts only after it was released.
    """

    def __init__(self, name: str, layout: str, device: str = "", host: Host | None = None) -> None:
        """Reads the layout; touches no device.

        Args:
            name: What its user calls it.
            layout: Name of a bundled layout, or the path of a YAML file.
            device: Path of the device's node; empty: the first that the layout fits.
            host: Whose devices; this machine's.

        Raises:
            LeaderError: The layout must not be used.
        """
        self.name = name
        self.layout: Layout = read_layout(layout)
        self.lost = ""
        """Why there is no device, or empty: the sentence that read raised."""
        self._wanted = device
        self._host = host if host is not None else EvdevHost()
        self._device: Device | None = None
        self._hand: Hand | None = None
        self._decoder = Decoder()
        self._grip: float | None = None
        self._loss: tuple[LeaderError, list[str] | None] | None = None
        self._nodes: list[str] = []
        self._look_again = -math.inf
        self._look_until = -math.inf

    def open(self) -> None:
        """Finds the device.

        Raises:
            LeaderError: There is none that fits, or it must not be read; says why and the cure.
        """
        self.close()
        try:
            self._take_up()
        except LeaderError as error:
            self.lost = str(error)
            raise

    def read(self, now: float) -> LeaderSample | None:
        """What the hand wants now.

        A device whose state holds until it says otherwise is stamped now, as long as it answers.

        Args:
            now: Steady clock [s].

        Returns:
            None while the device is not there.

        Raises:
            LeaderError: It has gone, once; which and what to do. Later calls look for it.
        """
        if self._device is None:
            self._look(now)
        if self._device is None:
            return None
        try:
            self._update(self._device, now)
        except OSError as error:
            raise self._lose(self._device, error, now) from error
        return self._hand.sample(now) if self._hand is not None else None

    def joy(self, now: float) -> Joy | None:
        """The device in numbers, as of the last read; None while it is not there."""
        return self._hand.joy(now) if self._hand is not None else None

    def close(self) -> None:
        """Lets go of the device."""
        if self._device is not None:
            self._device.close()
        if self._hand is not None:
            self._grip = self._hand.grip
        self._device, self._hand, self._decoder = None, None, Decoder()

    def _update(self, device: Device, now: float) -> None:
        if self._hand is None:
            device.read()  # older than the snapshot
            self._decoder = Decoder()
            snapshot = device.snapshot()
            self._hand = Hand(self.layout, device.description, snapshot, now, self._grip)
        for group in self._decoder.feed(device.read()):
            if group is None:
                self._hand.restart(device.snapshot(), now)
            else:
                self._hand.apply(group, now)

    def _lose(self, device: Device, error: OSError, now: float) -> LeaderError:
        description = device.description
        self.close()
        self._nodes = []
        self._look_again = now + LOOK_EVERY
        lost = LeaderError(
            f"has gone ({error.strerror})",
            f"{self.name}: '{description.name}' ({description.path})",
            "plug it in again; nothing moves before its buttons were released and pressed anew",
        )
        self.lost = str(lost)
        self._loss = lost, None
        return lost

    def _take_up(self) -> None:
        """Opens the device. While nothing else is plugged in, a lost one is what is missed."""
        try:
            self._device = find(self._host, self.layout, self._wanted)
        except LeaderError as error:
            if self._loss is None:
                raise
            loss, before = self._loss
            nodes = self._host.nodes()
            self._loss = loss, nodes if before is None else before
            raise (loss if self._loss[1] == nodes else error) from None
        self.lost, self._loss = "", None

    def _look(self, now: float) -> None:
        if not self.lost or now < self._look_again:
            return
        self._look_again = now + LOOK_EVERY
        nodes = self._host.nodes()
        if nodes != self._nodes:
            self._nodes, self._look_until = nodes, now + LOOK_FOR
        if now > self._look_until:
            return
        try:
            self._take_up()
        except LeaderError as error:
            self.lost = str(error)
