"""Who has the arms: how a policy gets them, and how it gives them up.

An arm comes to a policy from PAUSED or DISABLED, or ENABLED and free, never from the hand of
another sender, and is claimed before the first step. It goes back through PAUSED, whatever the
reason was: then nobody holds it, and the next sender begins at its set-point (F30). Nothing resumes
by itself: it takes `Handover.ask`.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence

from surg_core.contract import SECOND_NS
from surg_policy_bridge.server.policy_arm import ArmCommand, ArmState, ArmView

RETRY = SECOND_NS // 2
"""[ns] A state command that has shown no effect is sent again after this."""
WAKING = 5 * SECOND_NS
"""[ns] Longest time that homing, enabling and claiming may take."""


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
        self._since = 0
        self._asked: dict[str, tuple[str, int]] = {}
        self._parting: dict[str, ArmCommand] = {}

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
        self.phase, self._since, self._asked = Phase.WAKING, now, {}
        self._parting = {}

    def leave(self, views: Mapping[str, ArmView]) -> None:
        """The policy lets go: what is ours, or is about to be, comes to rest and is PAUSED."""
        if self.phase is not Phase.AWAY:
            self._parting = {
                name: ArmCommand(state="pause", hold=True)
                for name in self._arms
                if name not in views or self._ours(views[name]) or self._woken(views[name], name)
            }
        self.phase, self._asked = Phase.AWAY, {}

    def commands(self, views: Mapping[str, ArmView], now: int) -> dict[str, ArmCommand]:
        """What the arms have to be told now, besides the steps."""
        if self._parting:
            parting, self._parting = self._parting, {}
            return parting
        if self.phase is not Phase.WAKING:
            return {}
        told = {name: self._wake(name, views.get(name), now) for name in self._arms}
        return {name: command for name, command in told.items() if command}

    def look(self, views: Mapping[str, ArmView], now: int) -> str:
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
            elif now - self._since > WAKING:
                return f"the arms did not become ready: {self._unready(views)}"
        elif not ready:
            return self._unready(views)
        return ""

    def _wake(self, name: str, view: ArmView | None, now: int) -> ArmCommand:
        if view is None or self._ready(view):
            return ArmCommand()
        if not view.homed:
            word = "home"
        elif view.state != ArmState.ENABLED:
            word = "resume" if view.state == ArmState.PAUSED else "enable"
        else:
            word = "claim"
        before, at = self._asked.get(name, ("", 0))
        if before == word and now - at < RETRY:
            return ArmCommand()
        self._asked[name] = (word, now)
        if word == "claim":
            return ArmCommand(claim=True)
        # The claim goes with the word that enables: no cycle lies between them.
        return ArmCommand(state=word, claim=word != "home")

    def _ready(self, view: ArmView) -> bool:
        return view.homed and view.state == ArmState.ENABLED and view.holder == self._node

    def _ours(self, view: ArmView) -> bool:
        """Whether pausing it takes nothing from another sender."""
        return view.state == ArmState.ENABLED and view.holder in ("", self._node)

    def _woken(self, view: ArmView, name: str) -> bool:
        """Whether it has been told to wake, and may do so in its next cycle."""
        word, _ = self._asked.get(name, ("home", 0))
        waking = self.phase is Phase.WAKING and word != "home"
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
