"""The 20 Hz grid in real time: when to observe, when a step is due, and what to send in between.

Step n holds the targets of grid time n. The way to it is played from grid time n - 1 on, at 125 Hz
(`playout`), which needs the step one period before the newest observation can have been answered.
If it is missing, the step before it is played in its place, one period late. So any answer within a
period is in time, whether it holds one step or fifty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_core.arm_view import ArmView
from surg_core.contract import STEP_NS
from surg_policy_bridge.server.model_server import ModelServer, ServerState
from surg_policy_bridge.server.playout import SEND, Piece
from surg_policy_bridge.server.policy_arm import Target


class StepClock:
    """Plays a server's steps in real time; grid time 0 is at ``start`` [ns]."""

    def __init__(self, arms: Sequence[str], start: int) -> None:
        self._arms, self._start = tuple(arms), start
        self._observed = -1
        self._step = -1
        self._begun = 0
        self._pieces: dict[str, Piece] = {}
        self._last: tuple[int, dict[str, Piece]] = (start, {})
        self._sent = self._turned = start - SEND

    def due(self) -> int:
        """Time of the next action of this clock [ns]; it may have passed.

        While nothing is played, it is a period of sending after the last `play`, or the next grid
        time: the time of the last set-point would stay in the past.
        """
        newest = self._sent if self._pieces else self._turned
        return min(newest + SEND, self._start + (self._step + 1) * STEP_NS)

    def step(self, now: int) -> int:
        """Number of the present grid time."""
        return (now - self._start) // STEP_NS

    def observe(self, now: int) -> int | None:
        """Number of a grid time that has just begun, once; otherwise None."""
        step = self.step(now)
        if step <= self._observed:
            return None
        self._observed = step
        return step

    def play(self, server: ModelServer, views: dict[str, ArmView], now: int) -> dict[str, Target]:
        """Set-points to send now, by arm; empty: none."""
        self._turned = now
        step = self.step(now)
        if step > self._step:
            self._step = step
            self._begin(server, views, step, now)
        if server.state is not ServerState.RUNNING:
            self._pieces, self._last = {}, (now, {})
        if not self._pieces or now - self._sent < SEND:
            return {}
        self._sent = now - (now - self._start) % SEND
        share = (now - self._begun) / (self._start + (self._step + 1) * STEP_NS - self._begun)
        return {name: piece.at(share) for name, piece in self._pieces.items()}

    def _begin(self, server: ModelServer, views: dict[str, ArmView], step: int, now: int) -> None:
        if self._pieces:
            self._last = (now, self._pieces)
        # From rest a stream begins with the first step there is: the one after it may be farther
        # away than a first step is allowed to be.
        order = (step + 1, step) if self._pieces else (step, step + 1)
        number = next((n for n in order if server.steps.coming(n) is not None), step)
        targets = server.execute(number, now, past=step)
        beyond = server.steps.coming(number + 1) if targets else None
        self._begun = now
        self._pieces = {
            name: self._piece(
                views[name], self._previous(name, now), goal, beyond[name] if beyond else None
            )
            for name, goal in targets.items()
        }

    def _previous(self, name: str, now: int) -> Piece | None:
        """The piece just played; None: the arm is at rest, or its stream has ended."""
        at, pieces = self._last
        return pieces.get(name) if now - at <= STEP_NS else None

    def _piece(
        self, view: ArmView, previous: Piece | None, goal: Target, beyond: Target | None
    ) -> Piece:
        if previous is None:
            start = Target.held(view)
            return Piece(start, goal, np.zeros_like(start.row), beyond)
        return Piece(previous.goal, goal, previous.slope, beyond)
