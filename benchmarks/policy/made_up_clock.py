"""A policy in real time on a made-up clock: late answers and old pictures, without ROS and wire.

The model server, its safety controller and its 20 Hz clock are those of the node in free-run; the
environment's controllers obey in every tick. Only the times are made up, so a roll-out repeats.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import STATE_KEY, STEP_NS, TICK_NS, image_key
from surg_policy_bridge.server import cell_spec
from surg_policy_bridge.server.model_server import VERSIONS, ModelServer, ServerSettings
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_arm import arm_state
from surg_policy_bridge.server.safety_controller import PACED, ArmLimits, SafetyController
from surg_policy_bridge.server.step_clock import StepClock
from surg_policy_client.observation import Observation as Seen
from surg_policy_client.observation import as_message
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message
from surg_sim.envs.cell_session import Tick
from surg_sim.envs.surg_env import SurgEnv

MS = 1_000_000
"""[ns]"""
PEER, NODE = b"policy", "/policy"


@dataclass(frozen=True)
class Delays:
    """What takes time; means [ms]. Each single one is drawn, from half to one and a half of it."""

    answer: float = 20.0  # from an observation to its answer
    picture: float = 50.0  # from exposure to the model server


@dataclass(frozen=True)
class Played:
    """How a roll-out went."""

    success: bool
    reason: str  # why not
    stopped: str  # why the server stopped the policy; empty: it did not
    refused: int  # steps by the safety controller, and commands by the controller
    rcm_max: float  # [m]


class Player:
    """One episode: the policy's side and the server's side of every tick."""

    def __init__(self, env: SurgEnv, policy: Any, delays: Delays, seed: int) -> None:
        self._env, self._policy, self._delays = env, policy, delays
        self._rng = np.random.default_rng(seed)
        cell, self._arms = env.session.cell, tuple(env.arms)
        self._R_BR = {a: np.array(env.session.controllers[a].X_BR[:3, :3]) for a in self._arms}
        limits = {arm: ArmLimits.of(cell.arms[arm]) for arm in self._arms}
        settings = ServerSettings(arms=self._arms, node=NODE)
        self.server = ModelServer(settings, SafetyController(limits, PACED), lambda: 1)
        self._holders = dict.fromkeys(self._arms, "")
        self._pictures: deque[tuple[int, dict[str, Any]]] = deque()
        self._newest: dict[str, Any] = {}
        self._waiting: Message | None = None
        self._answer: tuple[int, Message] | None = None
        self._clock: StepClock | None = None
        self.stopped = ""

    def _drawn(self, mean: float) -> int:
        return round(mean * MS * self._rng.uniform(0.5, 1.5))

    def expose(self, now: int, images: dict[str, Any]) -> None:
        """A picture is taken at a grid time; it arrives later."""
        named = {image_key(f"endoscope_{view}"): p for view, p in images.items()}
        self._pictures.append((now + self._drawn(self._delays.picture), named))

    def tick(self, before: Tick) -> dict[str, ArmCommands]:
        """Commands of the next tick."""
        now = before.tick * TICK_NS
        views = {
            arm: replace(
                ArmView.of(before.outputs[arm]),
                stamp_ns=now,
                R_BR=self._R_BR[arm],
                holder=self._holders[arm],
            )
            for arm in self._arms
        }
        while self._pictures and self._pictures[0][0] <= now:
            self._newest = self._pictures.popleft()[1]
        if not self._newest:
            return {}
        if self._clock is None:
            self._begin(now, views)
        commands = self.server.tick(views, now, now)
        step = self._clock.observe(now) if self._clock else None
        if step is not None:
            numbers = [n for arm in self._arms for n in arm_state(views[arm])]
            arrays = {STATE_KEY: np.array(numbers, "<f4"), **self._newest}
            self.server.observe(Observation(step, now, arrays), now, now)
        self._talk(now)
        assert self._clock is not None
        for arm, target in self._clock.play(self.server, views, now).items():
            commands[arm] = target.commands()
        for arm, command in commands.items():
            if command.claim:
                self._holders[arm] = NODE
        if self.server.state.value == "PAUSED" and not self.stopped:
            self.stopped = self.server.reason
        return commands

    def _begin(self, now: int, views: dict[str, ArmView]) -> None:
        """The first pictures are there: the policy connects and is enabled."""
        env = self._env
        sizes = {k.removeprefix("observation.images."): p.shape for k, p in self._newest.items()}
        cameras = {name.replace(".", "_"): shape[:2] for name, shape in sizes.items()}
        spec = cell_spec.make(env.session.cell, self._arms, "bgr", cameras, None)
        self.server.serve(spec, now)
        wants = Spec.of_keys([STATE_KEY, *self._newest]).to_map()
        head = {
            "versions": [1, 1],
            "client": "made up",
            "software": "",
            "policy": "",
            "wants": wants,
        }
        self.server.receive(PEER, Message("HELLO", head), now)
        self._spec = spec
        self.server.tick(views, now, now)
        if refused := self.server.enable(True, now):
            raise RuntimeError(refused)
        # The grid of the server has nothing to do with that of the simulator.
        self._clock = StepClock(
            self._arms, now - int(self._rng.integers(STEP_NS // TICK_NS)) * TICK_NS
        )

    def _talk(self, now: int) -> None:
        """Messages of both sides; the policy works at one observation at a time."""
        server = self.server
        if server.session is not None:
            server.receive(PEER, Message("PING", {"session": server.session.number, "n": 1}), now)
        if self._answer is not None and now >= self._answer[0]:
            message, self._answer = self._answer[1], None
            server.receive(PEER, message, now)
        for _, message in server.replies:
            if message.kind == "OBS":
                self._waiting = message
            elif message.kind == "ACK" and hasattr(self._policy, "acknowledged"):
                self._policy.acknowledged(message.head)
        server.replies.clear()
        if self._answer is None and self._waiting is not None:
            seen = Seen.of(self._waiting, self._spec)
            self._waiting = None
            answer = as_message(self._policy.act(seen), seen)
            self._answer = (now + self._drawn(self._delays.answer), answer)


def play(env: SurgEnv, policy: Any, delays: Delays, seed: int) -> Played:
    """One roll-out; the environment is reset and has to show pictures."""
    seen, _ = env.reset(seed=seed)
    policy.reset("", seed)
    player = Player(env, policy, delays, seed)
    done, worst = False, 0.0
    while not done:
        player.expose(env.session.world.tick * TICK_NS, seen["images"])
        seen, _, terminated, truncated, info = env.stream(player.tick)
        done = terminated or truncated
        worst = max(worst, *(info["rcm_error"][arm] for arm in env.arms))
    return Played(
        success=info["success"],
        reason=info["reason"],
        stopped=player.stopped,
        refused=sum(player.server.counters.rejected.values()) + info["refused"],
        rcm_max=worst,
    )


assert 1 in VERSIONS  # its player answers as version 1 does
