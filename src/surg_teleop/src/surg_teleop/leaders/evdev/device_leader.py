"""A leader on an event device: finds it, reads it, reports its loss, and finds it again."""

from __future__ import annotations

import math
from typing import ClassVar

from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.leaders.evdev.device_hand import Hand, Joy
from surg_teleop.leaders.evdev.device_host import Device, Host
from surg_teleop.leaders.evdev.device_layout import read_layout
from surg_teleop.leaders.evdev.device_search import find
from surg_teleop.leaders.evdev.input_events import Groups
from surg_teleop.leaders.leader import LeaderError

LOOK_EVERY = 0.5
"""[s] Interval of the search for a lost device."""
LOOK_FOR = 3.0
"""[s] The search lasts this long after the list of nodes has changed: udev grants the permission
after it makes the node, and devices that do not fit are not opened for ever."""


class InputLeader:
    """A leader on one event device.

    It looks for a device that was unplugged, and opens it again. The hand then starts anew: what is
    held down at that moment counts only after it was released.

    Args:
        name: For messages and topics; empty: its kind.
        layout: Name of a bundled layout, or the path of a YAML file; empty: the kind's.
        device: Path of the device's node; empty: the first that the layout fits.
        host: Whose devices; None: this machine's.

    Raises:
        LeaderError: The layout must not be used.
    """

    kind: ClassVar[str]
    """Default name and layout."""

    def __init__(
        self, name: str = "", layout: str = "", device: str = "", host: Host | None = None
    ) -> None:
        self.name = name or self.kind
        self.layout = read_layout(layout or self.kind)
        self.lost = ""
        """Why there is no device, as the error of `read` states it; empty: there is one."""
        self._wanted = device
        self._host = host or Host()
        self._device: Device | None = None
        self._hand: Hand | None = None
        self._groups = Groups()
        self._grip: float | None = None
        self._loss: tuple[LeaderError, list[str] | None] | None = None
        self._nodes: list[str] = []
        self._look_again = self._look_until = -math.inf

    def open(self) -> None:
        """Find the device.

        Raises:
            LeaderError: No device fits, or it must not be read.
        """
        self.close()
        try:
            self._take_up()
        except LeaderError as error:
            self.lost = str(error)
            raise

    def read(self, now: float) -> LeaderSample | None:
        """The hand's sample, stamped now as long as the device answers; None: it is not there.

        Raises:
            LeaderError: The device has gone; raised once, later calls look for it.
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
        """Raw state of the device at the last read; None: it is not there."""
        return self._hand.joy(now) if self._hand is not None else None

    def close(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.close()
        if self._hand is not None:
            self._grip = self._hand.grip
        self._device, self._hand, self._groups = None, None, Groups()

    def _update(self, device: Device, now: float) -> None:
        if self._hand is None:
            device.read()  # older than the snapshot
            self._groups = Groups()
            snapshot = device.snapshot()
            self._hand = Hand(self.layout, device.description, snapshot, now, self._grip)
        for group in self._groups.feed(device.read()):
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
        """Open the device; until another one is plugged in, the error is that of the loss."""
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
