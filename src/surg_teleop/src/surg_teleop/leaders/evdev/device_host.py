"""Access to the kernel's event devices by python3-evdev."""

from __future__ import annotations

import contextlib
from pathlib import Path

import evdev
from evdev import ecodes

from surg_teleop.leaders.evdev.device_state import AxisRange, Description, Snapshot

FOLDER = Path("/dev/input")


class Device:
    """An open event device; every call but `close` raises OSError if it is unplugged.

    Raises:
        OSError: The node cannot be opened (PermissionError), or is not an event device.
    """

    def __init__(self, path: str) -> None:
        self._device = evdev.InputDevice(path)
        try:
            able = self._device.capabilities(absinfo=True)
            self.description = Description(
                path=path,
                name=str(self._device.name),
                bus=int(self._device.info.bustype),
                keys=frozenset(able.get(ecodes.EV_KEY, [])),
                axes={code: AxisRange(i.min, i.max) for code, i in able.get(ecodes.EV_ABS, [])},
                relative=frozenset(able.get(ecodes.EV_REL, [])),
            )
        except OSError:
            self._device.close()
            raise

    def grab(self) -> None:
        """Take its events exclusively; OSError also if another process has them."""
        self._device.grab()

    def snapshot(self) -> Snapshot:
        """Its whole state."""
        return Snapshot(
            frozenset(self._device.active_keys()),
            {code: self._device.absinfo(code).value for code in self.description.axes},
        )

    def read(self) -> list[evdev.InputEvent]:
        """New events; there may be none."""
        events: list[evdev.InputEvent] = []
        with contextlib.suppress(BlockingIOError):  # there are no more
            while True:
                events.extend(self._device.read())
        return events

    def close(self) -> None:
        """Close it; never fails."""
        with contextlib.suppress(OSError):  # it may be gone already
            self._device.close()


class Host:
    """A machine with event devices: this one."""

    def nodes(self) -> list[str]:
        """Paths of the event nodes, in the order of their numbers."""
        paths = [path for path in FOLDER.glob("event*") if path.name[5:].isdigit()]
        return [str(path) for path in sorted(paths, key=lambda path: int(path.name[5:]))]

    def open(self, path: str) -> Device:
        """Open one."""
        return Device(path)
