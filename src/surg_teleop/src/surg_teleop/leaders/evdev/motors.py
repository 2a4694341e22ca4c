"""The motors of a gamepad, by the kernel's force feedback."""

from __future__ import annotations

import contextlib

import evdev
from evdev import ecodes, ff

FULL = 0xFFFF


class Motors:
    """One rumble effect of an open device. The kernel stops it when the device is closed."""

    def __init__(self, device: evdev.InputDevice) -> None:
        self._device = device
        self._effect = -1
        able = device.capabilities().get(ecodes.EV_FF, [])
        self.there = ecodes.FF_RUMBLE in able

    def play(self, strength: float, seconds: float) -> None:
        """Rumble for so long [s], 0 to 1; what plays now is replaced. Strength 0 stops.

        A device that does not take it is not felt; its loss is noticed by reading.
        """
        if not self.there:
            return
        level = round(FULL * strength)
        milliseconds = max(1, int(1e3 * seconds))
        with contextlib.suppress(OSError):
            if level == 0:
                if self._effect >= 0:
                    self._device.write(ecodes.EV_FF, self._effect, 0)
                return
            effect = ff.Effect(
                ecodes.FF_RUMBLE,
                self._effect,
                0,
                ff.Trigger(0, 0),
                ff.Replay(milliseconds, 0),
                ff.EffectType(ff_rumble_effect=ff.Rumble(level, level)),
            )
            self._effect = self._device.upload_effect(effect)
            self._device.write(ecodes.EV_FF, self._effect, 1)
