"""What a device says now: axes from -1 to 1, keys pressed. Pure: events in, values out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from surg_teleop.leaders.evdev.input_events import EV_ABS, EV_KEY, EV_REL, Event

BUS_BLUETOOTH = 0x05

RELATIVE_HOLD = 0.1
"""[s] A device with relative axes (older SpaceMouse) says its deflection again and again while it
is deflected, and nothing once it is let go: that long after its last word it is at rest."""
RELATIVE_FULL = 350
"""Reading of a SpaceMouse at full deflection, where the device does not state its range."""


@dataclass(frozen=True)
class AxisRange:
    """Range of readings of an absolute axis, as the device states it."""

    minimum: int
    maximum: int

    def normal(self, reading: int) -> float:
        """Reading as -1 ... 1 (0 where the range is empty); outside it, its end."""
        if not self.maximum > self.minimum:
            return 0.0
        part = (reading - self.minimum) / (self.maximum - self.minimum)
        return min(1.0, max(-1.0, 2.0 * part - 1.0))


@dataclass(frozen=True)
class Description:
    """What a device is and has.

    Attributes:
        path: Its node, ``/dev/input/event3``.
        name: As it calls itself.
        bus: How it is connected, numbered as in <linux/input.h>.
        keys: Codes of its keys and buttons.
        axes: Absolute axes by code.
        relative: Codes of its relative axes.
    """

    path: str
    name: str
    bus: int = 0
    keys: frozenset[int] = frozenset()
    axes: Mapping[int, AxisRange] = field(default_factory=dict)
    relative: frozenset[int] = frozenset()

    @property
    def wireless(self) -> bool:
        """Whether it can go out of range without anybody unplugging it."""
        return self.bus == BUS_BLUETOOTH


@dataclass(frozen=True)
class Snapshot:
    """The whole state of a device at one moment, as asked for.

    Attributes:
        keys: Codes of the keys that are down.
        axes: Readings of the absolute axes by code.
    """

    keys: frozenset[int] = frozenset()
    axes: Mapping[int, int] = field(default_factory=dict)


class InputState:
    """Follows one device from its events."""

    def __init__(self, description: Description, snapshot: Snapshot, now: float) -> None:
        """Starts from the state that the device is in.

        Args:
            description: What the device has.
            snapshot: Its state.
            now: Time of it [s].
        """
        self.description = description
        self.changed = now
        """Time of the last event [s]."""
        self._relative: dict[int, tuple[int, float]] = {}
        self.restart(snapshot, now)

    def restart(self, snapshot: Snapshot, now: float) -> None:
        """Takes over a whole state, after events were lost."""
        self._keys = set(snapshot.keys)
        self._axes = dict(snapshot.axes)
        self._relative.clear()
        self.changed = now

    def apply(self, group: Iterable[Event], now: float) -> None:
        """Takes one group of events, received at a time [s]."""
        for event in group:
            if event.kind == EV_KEY:
                (self._keys.add if event.value else self._keys.discard)(event.code)
            elif event.kind == EV_ABS:
                self._axes[event.code] = event.value
            elif event.kind == EV_REL:
                self._relative[event.code] = (event.value, now)
        self.changed = now

    def pressed(self, code: int) -> bool:
        """Whether a key is down."""
        return code in self._keys

    def absolute(self, code: int, dead_zone: float) -> float:
        """An absolute axis, -1 ... 1.

        Args:
            code: Which.
            dead_zone: Half width of the zone round the middle that counts as 0; beyond it the value
                grows from 0, so that there is no step at its edge.
        """
        span = self.description.axes.get(code)
        if span is None or code not in self._axes:
            return 0.0
        return without_dead_zone(span.normal(self._axes[code]), dead_zone)

    def one_sided(self, code: int, dead_zone: float) -> float:
        """An axis that rests at its minimum, 0 ... 1; the dead zone lies at its rest."""
        span = self.description.axes.get(code)
        if span is None or code not in self._axes:
            return 0.0
        return without_dead_zone((span.normal(self._axes[code]) + 1.0) / 2.0, dead_zone)

    def relative(self, code: int, dead_zone: float, now: float) -> float:
        """The same for a relative axis that stands for a deflection."""
        reading, since = self._relative.get(code, (0, now))
        if not now - since <= RELATIVE_HOLD:
            return 0.0
        return without_dead_zone(max(-1.0, min(1.0, reading / RELATIVE_FULL)), dead_zone)


def without_dead_zone(value: float, dead_zone: float) -> float:
    """Cuts the middle out of -1 ... 1 and stretches the rest: continuous, odd, 1 at 1."""
    beyond = abs(value) - dead_zone
    if not beyond > 0.0:
        return 0.0
    return (1.0 if value > 0 else -1.0) * beyond / (1.0 - dead_zone)
