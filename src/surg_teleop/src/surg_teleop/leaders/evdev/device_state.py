"""State of an input device: axes from -1 to 1, pressed keys. Pure: events in, values out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from evdev import InputEvent, ecodes

BUS_BLUETOOTH = 0x05

RELATIVE_HOLD = 0.1
"""[s] Devices with relative axes (older SpaceMouse) repeat their deflection while deflected and are
silent at rest. After this silence they count as at rest."""
RELATIVE_FULL = 350
"""Full deflection of a SpaceMouse that does not state its range."""


@dataclass(frozen=True)
class AxisRange:
    """Range of an absolute axis, as stated by the device."""

    minimum: int
    maximum: int

    def normal(self, reading: int) -> float:
        """Reading scaled and clipped to -1 ... 1; 0 if the range is empty."""
        if not self.maximum > self.minimum:
            return 0.0
        part = (reading - self.minimum) / (self.maximum - self.minimum)
        return min(1.0, max(-1.0, 2.0 * part - 1.0))


@dataclass(frozen=True)
class Description:
    """Description of a device."""

    path: str  # its node, ``/dev/input/event3``
    name: str
    bus: int = 0  # bus type of <linux/input.h>
    keys: frozenset[int] = frozenset()  # codes of its keys and buttons
    axes: Mapping[int, AxisRange] = field(default_factory=dict)  # absolute axes by code
    relative: frozenset[int] = frozenset()  # codes of its relative axes

    @property
    def wireless(self) -> bool:
        """Whether it can get out of range without being unplugged."""
        return self.bus == BUS_BLUETOOTH


@dataclass(frozen=True)
class Snapshot:
    """The whole state of a device."""

    keys: frozenset[int] = frozenset()
    axes: Mapping[int, int] = field(default_factory=dict)  # readings of the absolute axes by code


class InputState:
    """Tracks the state of one device by its events."""

    def __init__(self, description: Description, snapshot: Snapshot, now: float) -> None:
        self.description = description
        self.changed = now
        """Time of the last event [s]."""
        self._relative: dict[int, tuple[int, float]] = {}
        self.restart(snapshot, now)

    def restart(self, snapshot: Snapshot, now: float) -> None:
        """Replace the state after a loss of events."""
        self._keys = set(snapshot.keys)
        self._axes = dict(snapshot.axes)
        self._relative.clear()
        self.changed = now

    def apply(self, group: Iterable[InputEvent], now: float) -> None:
        """Apply one group of events, received now [s]."""
        for event in group:
            if event.type == ecodes.EV_KEY:
                (self._keys.add if event.value else self._keys.discard)(event.code)
            elif event.type == ecodes.EV_ABS:
                self._axes[event.code] = event.value
            elif event.type == ecodes.EV_REL:
                self._relative[event.code] = (event.value, now)
        self.changed = now

    def pressed(self, code: int) -> bool:
        """Whether a key is down."""
        return code in self._keys

    def absolute(self, code: int, one_sided: bool = False) -> float:
        """An absolute axis, -1 ... 1; one-sided, it rests at its minimum: 0 ... 1."""
        span = self.description.axes.get(code)
        if span is None or code not in self._axes:
            return 0.0
        value = span.normal(self._axes[code])
        return (value + 1.0) / 2.0 if one_sided else value

    def relative(self, code: int, now: float) -> float:
        """A relative axis that reports a deflection, -1 ... 1."""
        reading, since = self._relative.get(code, (0, now))
        if not now - since <= RELATIVE_HOLD:
            return 0.0
        return max(-1.0, min(1.0, reading / RELATIVE_FULL))


def without_dead_zone(value: float, dead_zone: float) -> float:
    """Apply a dead zone to -1 ... 1; the result is continuous, odd, and 1 at 1."""
    beyond = abs(value) - dead_zone
    if not beyond > 0.0:
        return 0.0
    return (1.0 if value > 0 else -1.0) * beyond / (1.0 - dead_zone)
