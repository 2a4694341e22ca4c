"""Access to the kernel's event devices by python3-evdev."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import Protocol

import evdev
from evdev import ecodes

from surg_teleop.leaders.evdev.device_state import AxisRange, Description, Snapshot

FOLDER = Path("/dev/input")


class Device(Protocol):
    """An open event device."""

    @property
    def description(self) -> Description:
        """What it is and has."""

    def snapshot(self) -> Snapshot:
        """Its whole state. Raises OSError if the device is gone."""

    def grab(self) -> None:
        """Take its events exclusively. Raises OSError if another process has them."""

    def read(self) -> bytes:
        """New bytes; may be empty. Raises OSError (ENODEV) if the device is gone."""

    def close(self) -> None:
        """Close it; never fails."""


class Host(Protocol):
    """A machine with event devices."""

    def nodes(self) -> list[str]:
        """Paths of the event nodes, in the order of their numbers."""

    def open(self, path: str) -> Device:
        """Open one. Raises OSError, such as PermissionError."""


class EvdevDevice:
    """An event device of this machine."""

    def __init__(self, path: str) -> None:
        """Open it.

        Raises:
            OSError: It cannot be opened, or is not an event device.
        """
        self._device = evdev.InputDevice(path)
        try:
            os.set_blocking(self._device.fd, False)
            self.description = describe(self._device)
        except OSError:
            self._device.close()
            raise

    def snapshot(self) -> Snapshot:
        """See `Device`."""
        return Snapshot(
            frozenset(self._device.active_keys()),
            {code: self._device.absinfo(code).value for code in self.description.axes},
        )

    def grab(self) -> None:
        """See `Device`."""
        self._device.grab()

    def read(self) -> bytes:
        """See `Device`."""
        return read_bytes(self._device.fd)

    def close(self) -> None:
        """See `Device`."""
        with contextlib.suppress(OSError):  # it may be gone already
            self._device.close()


class EvdevHost:
    """This machine."""

    def nodes(self) -> list[str]:
        """Paths of the event nodes."""
        try:
            names = os.listdir(FOLDER)
        except OSError:
            return []
        numbers = sorted(int(n[5:]) for n in names if n.startswith("event") and n[5:].isdigit())
        return [str(FOLDER / f"event{number}") for number in numbers]

    def open(self, path: str) -> Device:
        """Open an event device."""
        return EvdevDevice(path)


def describe(device: evdev.InputDevice) -> Description:
    """Description of a device of this machine."""
    able = device.capabilities(absinfo=True)
    axes = {code: AxisRange(info.min, info.max) for code, info in able.get(ecodes.EV_ABS, [])}
    return Description(
        path=str(device.path),
        name=str(device.name),
        bus=int(device.info.bustype),
        keys=frozenset(able.get(ecodes.EV_KEY, [])),
        axes=axes,
        relative=frozenset(able.get(ecodes.EV_REL, [])),
    )


def read_bytes(fd: int) -> bytes:
    """Read all available bytes of a non-blocking descriptor; there may be none.

    Raises:
        OSError: ENODEV if the device, or the other end of the pipe, is gone.
    """
    data = b""
    while True:
        try:
            part = os.read(fd, 4096)
        except BlockingIOError:
            return data
        except OSError:
            if data:  # its last bytes; the next call raises
                return data
            raise
        if not part:
            if data:
                return data
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        data += part
