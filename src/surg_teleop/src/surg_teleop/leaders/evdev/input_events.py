"""Groups of the kernel's input events: simultaneous changes, which end with SYN_REPORT."""

from __future__ import annotations

from collections.abc import Iterable

from evdev import InputEvent, ecodes


class Groups:
    """Collects events to complete groups.

    After SYN_DROPPED (overflow of the kernel's buffer) all events up to the next SYN_REPORT are
    discarded, and the device must be asked for its whole state.
    """

    def __init__(self) -> None:
        self._group: list[InputEvent] = []
        self._dropping = False

    def feed(self, events: Iterable[InputEvent]) -> list[list[InputEvent] | None]:
        """Complete groups of events, without SYN_REPORT; None stands for a loss of events."""
        groups: list[list[InputEvent] | None] = []
        for event in events:
            if (event.type, event.code) == (ecodes.EV_SYN, ecodes.SYN_DROPPED):
                self._dropping = True
            elif (event.type, event.code) == (ecodes.EV_SYN, ecodes.SYN_REPORT):
                groups.append(None if self._dropping else self._group)
                self._group, self._dropping = [], False
            elif not self._dropping:
                self._group.append(event)
        return groups
