"""Input devices made of pipes: a gamepad, pedals, a SpaceMouse that a test presses and unplugs."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass, field, replace

from evdev import ecodes

from surg_teleop.leaders.evdev.device_host import Device, read_bytes
from surg_teleop.leaders.evdev.device_state import AxisRange, Description, Snapshot
from surg_teleop.leaders.evdev.input_events import (
    EV_ABS,
    EV_KEY,
    EV_REL,
    EV_SYN,
    EVENT,
    SYN_DROPPED,
    SYN_REPORT,
    Event,
)

REPORT = Event(EV_SYN, SYN_REPORT, 0)
DROPPED = Event(EV_SYN, SYN_DROPPED, 0)


def to_bytes(event: Event) -> bytes:
    """As the kernel writes it, at time 0."""
    return EVENT.pack(0, 0, event.kind, event.code, event.value)


STICK = AxisRange(-32768, 32767)
TRIGGER = AxisRange(0, 255)
CAP = AxisRange(-350, 350)


def code(name: str) -> int:
    """The kernel's number of a name."""
    number = ecodes.ecodes[name]
    assert isinstance(number, int)
    return number


GAMEPAD = Description(
    path="/dev/input/event7",
    name="Some Pad",
    bus=0x03,
    keys=frozenset(
        code(f"BTN_{key}")
        for key in ("SOUTH", "EAST", "WEST", "NORTH", "TL", "TR", "SELECT", "START", "MODE")
    ),
    axes={
        **{code(f"ABS_{axis}"): STICK for axis in ("X", "Y", "RX", "RY")},
        **{code(f"ABS_{axis}"): TRIGGER for axis in ("Z", "RZ")},
    },
)
PEDALS = Description(
    path="/dev/input/event9",
    name="PCsensor FootSwitch",
    bus=0x03,
    keys=frozenset(range(1, 120)),
)
SPACEMOUSE = Description(
    path="/dev/input/event5",
    name="3Dconnexion SpaceMouse Compact",
    bus=0x03,
    keys=frozenset({code("BTN_0"), code("BTN_1")}),
    axes={code(f"ABS_{axis}"): CAP for axis in ("X", "Y", "Z", "RX", "RY", "RZ")},
)
SPACEMOUSE_RELATIVE = replace(
    SPACEMOUSE,
    axes={},
    relative=frozenset(code(f"REL_{axis}") for axis in ("X", "Y", "Z", "RX", "RY", "RZ")),
)
KEYBOARD = replace(PEDALS, path="/dev/input/event0", name="AT Keyboard")


@dataclass
class Plugged:
    """A device in the hands of a test; what it writes is what the kernel would."""

    description: Description
    down: set[int] = field(default_factory=set)
    readings: dict[int, int] = field(default_factory=dict)
    grabbed: bool = False
    busy: bool = False
    _pipes: list[tuple[int, int]] = field(default_factory=list)
    _there: bool = True

    def __post_init__(self) -> None:
        for axis, span in self.description.axes.items():
            trigger = span.minimum == 0
            self.readings.setdefault(axis, 0 if trigger else (span.minimum + span.maximum) // 2)

    def press(self, *names: str) -> None:
        """Presses keys and says so, in one group."""
        self._keys(1, names)

    def release(self, *names: str) -> None:
        """Lets go of keys."""
        self._keys(0, names)

    def push(self, name: str, part: float) -> None:
        """Moves an absolute axis, -1 ... 1 of its range (a trigger: 0 ... 1)."""
        axis = code(name)
        span = self.description.axes[axis]
        whole = span.maximum - span.minimum
        share = part if span.minimum == 0 else (part + 1.0) / 2.0
        self.readings[axis] = round(span.minimum + whole * share)
        self.send(Event(EV_ABS, axis, self.readings[axis]), REPORT)

    def shove(self, name: str, reading: int) -> None:
        """Reports a relative axis."""
        self.send(Event(EV_REL, code(name), reading), REPORT)

    def lose(self, *events: Event) -> None:
        """The kernel's buffer runs over: what happened meanwhile is not told."""
        self.send(DROPPED, *events, REPORT)

    def unplug(self) -> None:
        """Takes it away: what reads it gets ENODEV."""
        self._there = False
        for _, write in self._pipes:
            if write >= 0:
                os.close(write)
        self._pipes = [(read, -1) for read, _ in self._pipes]

    def send(self, *events: Event) -> None:
        """Writes events to whoever has opened it."""
        for _, write in self._pipes:
            os.write(write, b"".join(to_bytes(event) for event in events))

    def _keys(self, value: int, names: tuple[str, ...]) -> None:
        codes = [code(name) for name in names]
        (self.down.update if value else self.down.difference_update)(codes)
        self.send(*(Event(EV_KEY, key, value) for key in codes), REPORT)

    def opened(self) -> PipeDevice:
        """What opening its node gives."""
        read, write = os.pipe()
        os.set_blocking(read, False)
        self._pipes.append((read, write))
        return PipeDevice(self, read, write)

    def closed(self, pair: tuple[int, int]) -> None:
        """One of those who read it has closed it."""
        self._pipes = [one for one in self._pipes if one[0] != pair[0]]
        self.grabbed = False


@dataclass
class PipeDevice:
    """A Device whose bytes come through a pipe."""

    plugged: Plugged
    read_end: int
    write_end: int
    open: bool = True

    @property
    def description(self) -> Description:
        """What it is and has."""
        return self.plugged.description

    def snapshot(self) -> Snapshot:
        """Its whole state."""
        if not self.plugged._there:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        return Snapshot(frozenset(self.plugged.down), dict(self.plugged.readings))

    def grab(self) -> None:
        """Takes it, unless somebody has it."""
        if self.plugged.busy:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        self.plugged.grabbed = True

    def read(self) -> bytes:
        """What has come since."""
        return read_bytes(self.read_end)

    def close(self) -> None:
        """Closes both ends."""
        if self.open:
            self.open = False
            os.close(self.read_end)
            if self.plugged._there:
                os.close(self.write_end)
            self.plugged.closed((self.read_end, self.write_end))


@dataclass
class Machine:
    """A Host: what is plugged in, and what must not be read."""

    plugged: list[Plugged] = field(default_factory=list)
    forbidden: set[str] = field(default_factory=set)

    def plug(self, device: Description) -> Plugged:
        """Plugs a device in."""
        self.plugged.append(Plugged(device))
        return self.plugged[-1]

    def unplug(self, device: Plugged) -> None:
        """Takes one out."""
        self.plugged.remove(device)
        device.unplug()

    def nodes(self) -> list[str]:
        """Paths of what is plugged in."""
        return sorted(one.description.path for one in self.plugged)

    def open(self, path: str) -> Device:
        """Opens a node."""
        if path in self.forbidden:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        for one in self.plugged:
            if one.description.path == path:
                return one.opened()
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
