"""Input devices in the hands of a test: a gamepad, pedals, a SpaceMouse, pressed and unplugged."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass, field, replace

from evdev import InputEvent, ecodes

from surg_teleop.leaders.evdev.device_host import Device
from surg_teleop.leaders.evdev.device_state import AxisRange, Description, Snapshot


def event(kind: int, code: int, value: int = 0) -> InputEvent:
    """What the kernel says at time 0."""
    return InputEvent(0, 0, kind, code, value)


REPORT = event(ecodes.EV_SYN, ecodes.SYN_REPORT)
DROPPED = event(ecodes.EV_SYN, ecodes.SYN_DROPPED)
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
    there: bool = True
    readers: list[OpenDevice] = field(default_factory=list)

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
        self.send(event(ecodes.EV_ABS, axis, self.readings[axis]), REPORT)

    def shove(self, name: str, reading: int) -> None:
        """Reports a relative axis."""
        self.send(event(ecodes.EV_REL, code(name), reading), REPORT)

    def lose(self, *events: InputEvent) -> None:
        """The kernel's buffer runs over: what happened meanwhile is not told."""
        self.send(DROPPED, *events, REPORT)

    def unplug(self) -> None:
        """Takes it away: what reads it gets ENODEV."""
        self.there = False

    def send(self, *events: InputEvent) -> None:
        """Sends events to whoever has opened it."""
        for reader in self.readers:
            reader.events.extend(events)

    def _keys(self, value: int, names: tuple[str, ...]) -> None:
        codes = [code(name) for name in names]
        (self.down.update if value else self.down.difference_update)(codes)
        self.send(*(event(ecodes.EV_KEY, key, value) for key in codes), REPORT)


@dataclass(eq=False)
class OpenDevice:
    """A Device that a test presses."""

    plugged: Plugged
    events: list[InputEvent] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.plugged.readers.append(self)

    @property
    def description(self) -> Description:
        """What it is and has."""
        return self.plugged.description

    def snapshot(self) -> Snapshot:
        """Its whole state."""
        self._ask()
        return Snapshot(frozenset(self.plugged.down), dict(self.plugged.readings))

    def grab(self) -> None:
        """Takes it, unless somebody has it."""
        if self.plugged.busy:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        self.plugged.grabbed = True

    def read(self) -> list[InputEvent]:
        """What has come since."""
        self._ask()
        events, self.events = self.events, []
        return events

    def close(self) -> None:
        """Lets it go."""
        if self in self.plugged.readers:
            self.plugged.readers.remove(self)
        self.plugged.grabbed = False

    def _ask(self) -> None:
        if not self.plugged.there:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))


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
                return OpenDevice(one)
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
