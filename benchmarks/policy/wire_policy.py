"""A policy on the wire in the place of a task's expert, through the model server's gate.

The same `ModelServer` and `SafetyController` as in the graph judge its steps, in lock-step: time
waits for each answer. A delay holds the answer to an observation back for so many grid times.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from policy.delayed_server import POLL_MS, DelayedServer, Line

from surg_core.arm_view import ArmView
from surg_core.contract import (
    FORCE_KEY,
    GRID,
    SECOND_NS,
    STATE_KEY,
    TASK_STATE_KEY,
    TICK_NS,
    image_key,
)
from surg_policy_bridge.server import cell_spec
from surg_policy_bridge.server.model_server import ServerSettings, ServerState
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_arm import rcm_frame
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_client.observation import RCM as RCM_KEY
from surg_policy_client.spec import Spec
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_messages import state_numbers
from surg_sim.tasks import scripted_sender
from surg_sim.tasks.scripted_sender import Action, Expert

NODE = "/policy"
PICTURE = (480, 640)
"""Height and width of the pictures that are served [px]."""
ANSWER_S = 30.0
"""Longest wall-clock wait for an answer [s]; a busy machine needs a second."""
CONNECT_S = 120.0
"""Longest wall-clock wait for a policy to connect [s]; its libraries load first."""

Arrays = dict[str, np.ndarray]


class PolicyLost(Exception):
    """The policy takes no further part; the message says why."""


class LineBroken(Exception):
    """The connection was lost on a busy machine: the episode is to be played again."""


@dataclass(frozen=True)
class Wire:
    """How a policy is reached.

    Attributes:
        address: At which it connects.
        ended: Why its program has ended; empty: it runs, or is somebody else's.
        answer_s: Longest wait for an answer [s].
        connect_s: Longest wait for it to connect [s].
    """

    address: str
    ended: Callable[[], str] = lambda: ""
    answer_s: float = ANSWER_S
    connect_s: float = CONNECT_S


class WirePolicy(Expert):
    """A policy as a sender of an episode.

    Args:
        session: The episode's.
        wire: How it is reached.
        views: That the cell's endoscope has.
        pictures: Draws views of the observed state.
        shown: What becomes of an observation before it is sent.
        delay: Of its answers, in grid times.

    Attributes:
        served: The specification that it got; None: it has not connected.
        server: Judges it; its counters are the episode's.
        reached: Whether it was in session.
    """

    def __init__(
        self,
        session: CellSession,
        wire: Wire,
        views: Sequence[str],
        pictures: Callable[[Sequence[str]], Mapping[str, np.ndarray]],
        shown: Callable[[Arrays], Arrays] = lambda arrays: arrays,
        delay: int = 0,
    ) -> None:
        self.arms = session.task.commanded
        self._session, self._wire, self._shown = session, wire, shown
        self._views, self._pictures = tuple(views), pictures
        self._holders: dict[str, str] = {}
        arms = {name: session.cell.arms[name] for name in self.arms}
        settings = ServerSettings(
            arms=tuple(self.arms),
            node=NODE,
            instruction=session.task.title,
            autostart=True,
            silence=round(wire.answer_s * SECOND_NS),
        )
        self.server = DelayedServer(self._spec, delay, settings, SafetyController(arms))
        self._line = Line(wire.address, self.server)
        self.served: Spec | None = None

    def greet(self) -> None:
        """Wait until the policy is in session.

        Raises:
            PolicyLost: It is refused, ends, or does not connect in time.
        """
        self._until(
            lambda: self.server.session is not None,
            self._wire.connect_s,
            f"it has not connected within {self._wire.connect_s:g} s",
        )
        assert self.server.session is not None
        self.served = self.server.session.spec

    def act(self, observation: scripted_sender.Observation) -> Action:
        """Observe, wait for the answer, execute what is due: `LockStep.turn` without a graph."""
        server, number = self.server, observation.tick // GRID
        at = observation.tick * TICK_NS
        views = {arm: self._view(arm, observation, at) for arm in self.arms}
        with self._line.lock:
            server.deliver(number, time.monotonic_ns())
            # At time 0 of the steady clock nobody is silent: a busy machine must not change a card.
            commands = server.tick(views, at, 0)
            running = server.state is ServerState.RUNNING
        if running:
            arrays = self._observe(views, observation)
            with self._line.lock:
                server.observe(Observation(number, at, arrays), at, time.monotonic_ns())
            self._await_answer()
            with self._line.lock:
                server.deliver(number, time.monotonic_ns())
                for arm, target in server.execute(number + 1, at).items():
                    commands[arm] = target.commands()
        self._line.rouse()
        if server.session is None or server.state is ServerState.PAUSED:
            raise PolicyLost(server.reason)
        for arm, command in commands.items():
            if command.claim:
                self._holders[arm] = NODE
        return Action(arms=commands)

    def end(self, success: bool, reason: str) -> None:
        """Tell the policy how the episode ended, and close the socket."""
        with self._line.lock:
            self.server.episode_over(success, reason)
            self.server.end("the episode is over")
        self._line.close()

    # --- what is observed -------------------------------------------------------------------------

    def _view(self, arm: str, observation: scripted_sender.Observation, at: int) -> ArmView:
        """The arm as its controller node would report it."""
        return replace(
            observation.arms[arm],
            stamp_ns=at,
            R_BR=self._session.told_R_BR(arm),
            R_WB=np.asarray(self._session.cell.arms[arm].X_WB)[:3, :3],
            holder=self._holders.get(arm, ""),
        )

    def _spec(self, named: Sequence[str] | None) -> Spec:
        """What is served to a policy that names its observations.

        The simulator's truth is served only to who names it; pictures to who names no key, too.
        """
        sizes = {f"endoscope_{view}": PICTURE for view in self._views}
        numbers = None
        if named is not None and TASK_STATE_KEY in named:
            numbers = cell_spec.task_numbers(state_numbers(self._session.task.state())[0])
        task = self._session.task.name
        return cell_spec.make(self._session.cell, self.arms, task, sizes, numbers, force=True)

    def _observe(
        self, views: Mapping[str, ArmView], observation: scripted_sender.Observation
    ) -> Arrays:
        """The arrays of the keys that the policy wants, as the lock-step node assembles them."""
        wanted, session = self.server.wanted, self._session
        made: dict[str, Callable[[], Any]] = {
            STATE_KEY: lambda: np.array([n for v in views.values() for n in v.numbers], "<f4"),
            RCM_KEY: lambda: np.array(
                [rcm_frame(v, np.asarray(session.cell.arms[a].X_WB)) for a, v in views.items()]
            ),
            FORCE_KEY: lambda: np.array(
                [n for arm in self.arms for n in session.observed_force(arm)], "<f4"
            ),
            TASK_STATE_KEY: lambda: np.array(state_numbers(dict(observation.task))[1], "<f4"),
        }
        arrays = {key: made[key]() for key in wanted if key in made}
        eyes = [view for view in self._views if image_key(f"endoscope_{view}") in wanted]
        if eyes:
            shown = self._pictures(eyes)
            arrays |= {image_key(f"endoscope_{view}"): shown[view] for view in eyes}
        return self._shown(arrays)

    # --- the wire ---------------------------------------------------------------------------------

    def _await_answer(self) -> None:
        session = self.server.session
        if session is None:
            raise PolicyLost(self.server.reason)
        wait = self._wire.answer_s
        late = f"no answer to an observation within {wait:g} s"
        self._until(lambda: self.server.heard >= session.seq, wait, late)

    def _until(self, come: Callable[[], bool], longest_s: float, late: str) -> None:
        """Wait until something has come."""
        server, line = self.server, self._line
        deadline, over = time.monotonic() + longest_s, ""
        line.rouse()
        with line.lock:
            while not come():
                if server.lost_touch:
                    raise LineBroken
                if server.refusal and self.served is None:
                    raise PolicyLost(f"refused: {server.refusal}")
                if server.session is None and self.served is not None:
                    raise PolicyLost(server.reason)
                if over or time.monotonic() > deadline:
                    raise PolicyLost(over or late)
                over = self._wire.ended()  # what it sent before is read once more
                line.lock.wait(POLL_MS * 1e-3)
