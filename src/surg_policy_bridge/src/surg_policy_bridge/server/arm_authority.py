"""Who has the arms: how a policy gets them, and how it gives them up.

An arm comes to a policy from PAUSED or DISABLED, or ENABLED and free, never from the hand of
another sender, and is claimed before the first step. It goes back through PAUSED, whatever the
reason was: then nobody holds it, and the next sender begins at its set-point (F30). Nothing resumes
by itself: it takes `Handover.ask`.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence

from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_core.bring_up import BringUp


class Phase(enum.Enum):
    """Of the arms."""

    AWAY = "away"
    WAKING = "waking"
    HELD = "held"


class Handover:
    """The arms that a policy commands.

    Args:
        arms: Their names.
        node: Caller id under which the commands are sent.
    """

    def __init__(self, arms: Sequence[str], node: str) -> None:
        self._arms, self._node = tuple(arms), node
        self.phase = Phase.AWAY
        self._bring_ups = {name: BringUp(resume=True, claim_as=node) for name in self._arms}
        self._parting: dict[str, ArmCommands] = {}

    def obstacle(self, views: Mapping[str, ArmView]) -> str:
        """Why the policy may not have the arms now, with the cure; empty: it may."""
        for name in self._arms:
            view = views.get(name)
            if view is None:
                return f"{name} is silent: is its controller running?"
            why = f" ({view.reason})" if view.reason else ""
            if view.state == ArmState.FAULT:
                return f"{name} is in FAULT{why}: enable it when the cause is gone"
            if view.holder not in ("", self._node):
                return f"{name} is held by {view.holder}: end that, or pause {name}, and try again"
        return ""

    def ask(self, now: int) -> None:
        """The policy shall have the arms."""
        self.phase, self._parting = Phase.WAKING, {}
        for bring_up in self._bring_ups.values():
            bring_up.start(now)

    def leave(self, views: Mapping[str, ArmView]) -> None:
        """The policy lets go: what is ours, or is about to be, comes to rest and is PAUSED."""
        if self.phase is not Phase.AWAY:
            self._parting = {
                name: ArmCommands(state="pause", hold=True)
                for name in self._arms
                if name not in views or self._ours(views[name]) or self._woken(views[name], name)
            }
        self.phase = Phase.AWAY
        for bring_up in self._bring_ups.values():
            bring_up.stop()

    def commands(self, views: Mapping[str, ArmView], now: int) -> dict[str, ArmCommands]:
        """What the arms have to be told now, besides the steps."""
        if self._parting:
            parting, self._parting = self._parting, {}
            return parting
        if self.phase is not Phase.WAKING:
            return {}
        wanted = {name: self._bring_ups[name].tick(views[name], now) for name in self._arms}
        return {name: commands for name, commands in wanted.items() if commands}

    def look(self, views: Mapping[str, ArmView]) -> str:
        """Follow what the arms say.

        Returns:
            Why the policy has to let go of them; empty: it has not.
        """
        if self.phase is Phase.AWAY:
            return ""
        if obstacle := self.obstacle(views):
            return obstacle
        ready = all(self._ready(views[name]) for name in self._arms)
        if self.phase is Phase.WAKING:
            if ready:
                self.phase = Phase.HELD
            for name, bring_up in self._bring_ups.items():
                if not bring_up.active and not self._ready(views[name]):
                    why = bring_up.reason or self._unready(views)
                    return f"the arms did not become ready: {name}: {why}"
        elif not ready:
            return self._unready(views)
        return ""

    def _ready(self, view: ArmView) -> bool:
        return view.ready and view.holder == self._node

    def _ours(self, view: ArmView) -> bool:
        """Whether pausing it takes nothing from another sender."""
        return view.state == ArmState.ENABLED and view.holder in ("", self._node)

    def _woken(self, view: ArmView, name: str) -> bool:
        """Whether it has been told to wake, and may do so in its next cycle."""
        last = self._bring_ups[name].last
        waking = self.phase is Phase.WAKING and last not in ("", "home")
        return waking and view.holder in ("", self._node)

    def _unready(self, views: Mapping[str, ArmView]) -> str:
        for name in self._arms:
            view = views[name]
            if not self._ready(view):
                why = f" ({view.reason})" if view.reason else ""
                if not view.homed or view.state != ArmState.ENABLED:
                    return f"{name} is {view.state.name if view.homed else 'not homed'}{why}"
                return f"{name} is not held by {self._node}"
        return ""
