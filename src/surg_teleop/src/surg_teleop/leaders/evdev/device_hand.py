"""Converts the state of a device to leader samples and Joy. Pure.

A button counts only after it was seen released once. So connecting a device never moves anything,
whatever is held down.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from evdev import InputEvent

from surg_core.hand.leader_sample import HandRate, LeaderSample
from surg_teleop.leaders.evdev.device_layout import Axis, Layout
from surg_teleop.leaders.evdev.device_state import (
    Description,
    InputState,
    Snapshot,
    without_dead_zone,
)

WIRELESS_QUIET = 2.0
"""[s] A stick held by a hand trembles, so it sends changes. A wireless device that is deflected and
silent for longer may be out of range."""
MAX_STEP = 0.05
"""[s] Longest step of the grip's integration, so that it does not jump after a pause."""


@dataclass(frozen=True)
class Joy:
    """As sensor_msgs/Joy: axes -1 ... 1 (triggers 0 ... 1) and buttons 0 or 1, in layout order."""

    axes: tuple[float, ...]
    buttons: tuple[int, ...]


class Hand:
    """One device with one layout, while it is connected."""

    def __init__(
        self,
        layout: Layout,
        description: Description,
        snapshot: Snapshot,
        now: float,
        grip: float | None = None,
    ) -> None:
        """Start from a snapshot; `grip`: opening of the jaw before a reconnection."""
        self.layout = layout
        self.grip = grip
        self._state = InputState(description, snapshot, now)
        self._axes = {axis.name: axis for axis in layout.axes}
        self._codes = {button.name: button.code for button in layout.buttons}
        self._released: set[str] = set()
        self._now = now
        self._note_released()

    def apply(self, group: Iterable[InputEvent], now: float) -> None:
        """Apply one group of events, received now [s]."""
        self._state.apply(group, now)
        self._note_released()

    def restart(self, snapshot: Snapshot, now: float) -> None:
        """Replace the state after a loss of events; every button must be released anew."""
        self._state.restart(snapshot, now)
        self._released.clear()
        self._note_released()

    def joy(self, now: float) -> Joy:
        """Raw state of the device."""
        return Joy(
            tuple(self._axis(axis, now) for axis in self.layout.axes),
            tuple(int(self._state.pressed(button.code)) for button in self.layout.buttons),
        )

    def sample(self, now: float) -> LeaderSample | None:
        """The present sample, stamped now; None: the device may be out of range."""
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
            action
            for action, button in layout.actions.items()
            # An action that fails to pressed counts at once.
            if self._pressed(button, action not in layout.fail_pressed)
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
        tilts = [name for name in ("tilt_x", "tilt_y") if name in self.layout.hand]
        tilt = np.array([rates.get(name, 0.0) for name in tilts]) if len(tilts) == 2 else None
        v_V = np.array([rates.get(name, 0.0) for name in ("x", "y", "z")])
        return HandRate(v_V, roll, tilt=tilt)

    def _axis(self, axis: Axis, now: float) -> float:
        if axis.relative:
            value = self._state.relative(axis.code, now)
        else:
            value = self._state.absolute(axis.code, axis.one_sided)
        return axis.sign * without_dead_zone(value, self.layout.dead_zone)

    def _pressed(self, button: str, after_release: bool = True) -> bool:
        """Whether it is down, and was seen released before."""
        return self._state.pressed(self._codes[button]) and (
            not after_release or button in self._released
        )

    def _note_released(self) -> None:
        self._released |= {n for n, code in self._codes.items() if not self._state.pressed(code)}

    def _integrate_grip(self, present: bool, now: float) -> None:
        """Integrate the triggers' rate, at first from closed: the jaw never opens by itself."""
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
            return False
        quiet = now - self._state.changed > WIRELESS_QUIET
        if quiet:
            self._released.clear()  # once back in range, the dead-man must be released first
        return quiet
