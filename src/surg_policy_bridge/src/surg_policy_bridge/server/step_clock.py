"""The grid of real time: when to observe, when a step is due, and what to send in between.

Step n says where the arms shall be at grid time n, so the way to it is played from grid time n - 1
on, at 125 Hz (`playout`). That takes a step more than the answer to the newest observation can have
brought by then. Where it has not come, the step before it is played in its place, a period late:
so an answer within a period is in time whether it brings one step or fifty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_policy_bridge.server.model_server import ModelServer, State
from surg_policy_bridge.server.playout import SEND, Piece
from surg_policy_bridge.server.policy_arm import ACTION, PERIOD, ArmView, Target


class FreeRun:
    """Plays a server's steps in real time.

    Args:
        arms: Those that the policy commands.
        start: Grid time 0 [ns].
    """

    def __init__(self, arms: Sequence[str], start: int) -> None:
        self._arms, self._start = tuple(arms), start
        self._seen = -1
        self._step = -1
        self._begun = 0
        self._pieces: dict[str, Piece] = {}
        self._last: tuple[int, dict[str, Piece]] = (start, {})
        self._sent = start - SEND

    def due(self, now: int) -> int:
        """When there is something to do again [ns]."""
        return min(self._sent + SEND, self._start + (self.step(now) + 1) * PERIOD)

    def step(self, now: int) -> int:
        """Number of the present grid time."""
        return (now - self._start) // PERIOD

    def observe(self, now: int) -> int | None:
        """The grid time that has just come, once; None: there is none."""
        step = self.step(now)
        if step <= self._seen:
            return None
        self._seen = step
        return step

    def play(self, server: ModelServer, views: dict[str, ArmView], now: int) -> dict[str, Target]:
        """What to send now, by arm; empty: nothing."""
        step = self.step(now)
        if step > self._step:
            self._step = step
            self._begin(server, views, step, now)
        if server.state is not State.RUNNING:
            self._pieces, self._last = {}, (now, {})
        if not self._pieces or now - self._sent < SEND:
            return {}
        self._sent = now - (now - self._start) % SEND
        share = (now - self._begun) / (self._start + (self._step + 1) * PERIOD - self._begun)
        return {name: piece.at(share) for name, piece in self._pieces.items()}

    def _begin(self, server: ModelServer, views: dict[str, ArmView], step: int, now: int) -> None:
        if self._pieces:
            self._last = (now, self._pieces)
        # Where the arms rest, a stream begins with the first step there is: the one after it may
        # lie farther away than a first step is allowed to.
        order = (step + 1, step) if self._pieces else (step, step + 1)
        number = next((n for n in order if server.coming(n) is not None), step)
        targets = server.execute(number, now, past=step)
        if not targets:
            self._pieces = {}
            return
        beyond = server.coming(number + 1)
        self._begun = now
        self._pieces = {
            name: self._piece(
                views[name], self._before(name, now), goal, beyond[name] if beyond else None
            )
            for name, goal in targets.items()
        }

    def _before(self, name: str, now: int) -> Piece | None:
        """What has just been played; None: the arm rests, or will when its stream has ended."""
        at, pieces = self._last
        return pieces.get(name) if now - at <= PERIOD else None

    def _piece(
        self, view: ArmView, before: Piece | None, goal: Target, beyond: Target | None
    ) -> Piece:
        if before is None:
            start = Target(view.p_set, view.roll_set, view.jaw_set)
            return Piece(start, goal, np.zeros(len(ACTION)), beyond)
        return Piece(before.goal, goal, before.slope, beyond)
