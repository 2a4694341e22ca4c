"""How a policy gets the arms, and how it gives them up.

A policy takes an arm that is PAUSED, DISABLED, or ENABLED and free, never one that another sender
holds, and claims it before the first step. It always returns an arm through PAUSED: then nobody
holds it, and the next sender starts at its set-point (F30). Nothing resumes by itself; it takes
`ArmAuthority.acquire`.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence

from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_core.bring_up import BringUp


class Phase(enum.Enum):
    """State of the authority over all arms."""

    RELEASED = "released"
    ACQUIRING = "acquiring"
    HELD = "held"


class ArmAuthority:
    """Authority over the arms that a policy commands; ``node`` is the sender of the commands."""

    def __init__(self, arms: Sequence[str], node: str) -> None:
        self._arms, self._node = tuple(arms), node
        self.phase = Phase.RELEASED
        self._bring_ups = {name: BringUp(resume=True, claim_as=node) for name in self._arms}
        self._pending: dict[str, ArmCommands] = {}

    def obstacle(self, views: Mapping[str, ArmView]) -> str:
        """Why the policy may not have the arms now, and what to do; empty: it may."""
        for name in self._arms:
            view = views.get(name)
            if view is None:
                return f"{name} is silent; check that its controller is running"
            why = f" ({view.reason})" if view.reason else ""
            if view.state == ArmState.FAULT:
                return f"{name} is in FAULT{why}; remove the cause, then enable it"
            if view.holder not in ("", self._node):
                return f"{name} is held by {view.holder}; end that, or pause {name}, and try again"
        return ""

    def acquire(self, now: int) -> None:
        """Start to bring up and claim the arms; ``now`` in [ns]."""
        self.phase, self._pending = Phase.ACQUIRING, {}
        for bring_up in self._bring_ups.values():
            bring_up.start(now)

    def release(self, views: Mapping[str, ArmView]) -> None:
        """Hold and pause every arm that is ours, or is about to be."""
        if self.phase is not Phase.RELEASED:
            self._pending = {
                name: ArmCommands(state="pause", hold=True)
                for name in self._arms
                if name not in views or self._pausable(views[name], name)
            }
        self.phase = Phase.RELEASED
        for bring_up in self._bring_ups.values():
            bring_up.stop()

    def monitor(self, views: Mapping[str, ArmView], now: int) -> str:
        """Follow the state of the arms that are not silent, at a time [ns].

        Returns why the policy has lost the arms; empty: it has not.
        """
        if self.phase is Phase.RELEASED:
            return ""
        if obstacle := self.obstacle(views):
            return obstacle
        ready = all(self._ready(views[name]) for name in self._arms)
        if self.phase is Phase.HELD:
            return "" if ready else self._unready(views)
        self._pending = {name: self._bring_ups[name].tick(views[name], now) for name in self._arms}
        if ready:
            self.phase = Phase.HELD
        for name, bring_up in self._bring_ups.items():
            if not bring_up.active and not self._ready(views[name]):
                why = bring_up.reason or self._unready(views)
                return f"the arms did not become ready: {name}: {why}"
        return ""

    def take_commands(self) -> dict[str, ArmCommands]:
        """Commands to send now besides the steps, by arm."""
        pending, self._pending = self._pending, {}
        return {name: commands for name, commands in pending.items() if commands}

    def _ready(self, view: ArmView) -> bool:
        return view.ready and view.holder == self._node

    def _pausable(self, view: ArmView, name: str) -> bool:
        """Whether pausing takes the arm from no other sender: it is up, or is being enabled."""
        last = self._bring_ups[name].last
        enabling = self.phase is Phase.ACQUIRING and last not in ("", "home")
        ours_or_free = view.holder in ("", self._node)
        return ours_or_free and (view.state == ArmState.ENABLED or enabling)

    def _unready(self, views: Mapping[str, ArmView]) -> str:
        for name in self._arms:
            view = views[name]
            if not self._ready(view):
                why = f" ({view.reason})" if view.reason else ""
                if not view.homed or view.state != ArmState.ENABLED:
                    return f"{name} is {view.state.name if view.homed else 'not homed'}{why}"
                return f"{name} is not held by {self._node}"
        return ""
