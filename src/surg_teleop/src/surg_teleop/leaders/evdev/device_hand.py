"""What a person wants, from what their device says: a sample of a leader, and Joy. Pure.

Nothing counts that was held down when the device was opened: each button must be seen released
once. So plugging a device in never moves anything, whatever lies on it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from surg_teleop.leaders.evdev.device_layout import Axis, Layout
from surg_teleop.leaders.evdev.device_state import Description, InputState, Snapshot
from surg_teleop.leaders.evdev.input_events import Event
from surg_teleop.leaders.leader import HandRate, LeaderSample

WIRELESS_QUIET = 2.0
"""[s] A stick that is held by a hand trembles and says so. A radio device that is deflected and
says nothing for that long may be out of range: its last word is no longer its state."""
MAX_STEP = 0.05
"""[s] Longest time over which the grip is integrated: after a pause it does not leap."""


@dataclass(frozen=True)
class Joy:
    """As sensor_msgs/Joy: axes -1 ... 1 (triggers 0 ... 1) and buttons 0 or 1, in layout order."""

    axes: tuple[float, ...]
    buttons: tuple[int, ...]


class Hand:
    """One device under one layout, from the moment it was opened to the moment it goes."""

    def __init__(
        self,
        layout: Layout,
        description: Description,
        snapshot: Snapshot,
        now: float,
        grip: float | None = None,
    ) -> None:
        """Starts with the state that the device is in.

        Args:
            layout: What its axes and buttons mean.
            description: What the device has.
            snapshot: Its state.
            now: Steady clock [s].
            grip: Opening of the jaw so far, of a device that is back.
        """
        self.layout = layout
        self.grip = grip
        self._state = InputState(description, snapshot, now)
        self._axes = {axis.name: axis for axis in layout.axes}
        self._codes = {button.name: button.code for button in layout.buttons}
        self._released: set[str] = set()
        self._quiet = False
        self._now = now
        self._see_released()

    def apply(self, group: Iterable[Event], now: float) -> None:
        """Takes one group of events that was received now [s]."""
        self._state.apply(group, now)
        self._see_released()

    def restart(self, snapshot: Snapshot, now: float) -> None:
        """Events were lost: takes over the whole state, and every button must be released anew."""
        self._state.restart(snapshot, now)
        self._released.clear()
        self._see_released()

    def joy(self, now: float) -> Joy:
        """The device in numbers; says what is, whether it may move anything or not."""
        return Joy(
            tuple(self._axis(axis, now) for axis in self.layout.axes),
            tuple(int(self._state.pressed(button.code)) for button in self.layout.buttons),
        )

    def sample(self, now: float) -> LeaderSample | None:
        """What the hand wants now.

        Args:
            now: Steady clock [s], not before that of the last call.

        Returns:
            A sample stamped now; None: the device may be out of range.
        """
        layout = self.layout
        present = layout.dead_man is None or self._pressed(layout.dead_man)
        rates = {
            name: full * self._axis(self._axes[axis], now)
            for name, (axis, full) in layout.hand.items()
        }
        if self._out_of_range(any(rates.values()), now):
            return None
        self._integrate_grip(present, now)
        buttons = {
            action for action, button in layout.actions.items() if self._acts(action, button)
        }
        if present and layout.dead_man is not None:
            buttons.add("present")
        return LeaderSample(
            stamp=now,
            rate=self._rate(rates if present else {}) if layout.hand else None,
            grip=self.grip if layout.grip is not None else None,
            buttons=frozenset(buttons),
        )

    def _rate(self, rates: dict[str, float]) -> HandRate:
        roll = rates.get("roll", 0.0)
        if self.layout.spherical:
            turn = np.array([rates.get(name, 0.0) for name in ("yaw", "pitch", "insertion")])
            return HandRate(np.zeros(3), roll, turn)
        return HandRate(np.array([rates.get(name, 0.0) for name in ("x", "y", "z")]), roll)

    def _axis(self, axis: Axis, now: float) -> float:
        dead_zone = self.layout.dead_zone
        if axis.relative:
            return axis.sign * self._state.relative(axis.code, dead_zone, now)
        if axis.one_sided:
            return axis.sign * self._state.one_sided(axis.code, dead_zone)
        return axis.sign * self._state.absolute(axis.code, dead_zone)

    def _pressed(self, button: str) -> bool:
        """Down, and pressed since the device was opened."""
        return button in self._released and self._state.pressed(self._codes[button])

    def _acts(self, action: str, button: str) -> bool:
        """Like _pressed; what fails to pressed counts from the start."""
        if action in self.layout.fail_pressed:
            return self._state.pressed(self._codes[button])
        return self._pressed(button)

    def _see_released(self) -> None:
        self._released |= {n for n, code in self._codes.items() if not self._state.pressed(code)}

    def _integrate_grip(self, present: bool, now: float) -> None:
        """The triggers say how fast; the jaw stays where it is without them.

        The first touch starts from closed: a jaw that somebody else has opened closes, and none
        opens by itself.
        """
        step, self._now = min(max(now - self._now, 0.0), MAX_STEP), now
        grip = self.layout.grip
        if grip is None or not present:
            return
        speed = grip.speed * (self._press(grip.open, now) - self._press(grip.close, now))
        if speed != 0.0:
            self.grip = min(1.0, max(0.0, (self.grip or 0.0) + speed * step))

    def _press(self, name: str, now: float) -> float:
        """How far a trigger or button is pressed, 0 ... 1."""
        if name in self._axes:
            return max(0.0, self._axis(self._axes[name], now))
        return float(self._pressed(name))

    def _out_of_range(self, deflected: bool, now: float) -> bool:
        if not self._state.description.wireless or not deflected:
            self._quiet = False
        elif now - self._state.changed > WIRELESS_QUIET:
            self._quiet = True
            self._released.clear()  # back in range, the dead-man must be released first
        return self._quiet and now - self._state.changed > WIRELESS_QUIET
