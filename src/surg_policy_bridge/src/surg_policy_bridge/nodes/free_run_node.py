"""The loop of the model server in real time: evaluate, observe, send, 125 times per second."""

from __future__ import annotations

import time

from surg_core.arm_view import ArmView
from surg_core.contract import SECOND_NS
from surg_policy_bridge.nodes.server_io_node import ServerIO
from surg_policy_bridge.server.step_clock import StepClock

FRESH = SECOND_NS // 4
"""[ns] Timeout of an arm. Its controller supervises the robot link itself."""


class FreeRun:
    """Every time is the steady clock's."""

    participant: None = None

    def __init__(self, io: ServerIO) -> None:
        self._io = io
        self._clock = StepClock(io.settings.arms, time.monotonic_ns())

    def now(self) -> int:
        """Time of the execution [ns]."""
        return time.monotonic_ns()

    def patience_ms(self) -> int:
        """Time until something is due [ms]."""
        return max(0, self._clock.due() - time.monotonic_ns()) // 1_000_000 + 1

    def turn(self) -> None:
        """Do what is due; with the lock held."""
        io, now = self._io, time.monotonic_ns()
        views = io.views(now - FRESH)
        cause, obstacle = io.refusal()
        camera = io.sources.camera_problem(now, views)
        commands = io.server.tick(views, now, now, obstacle, camera, cause)
        step = self._clock.observe(now)
        if step is not None:
            self._observe(step, views, now)
        for arm, target in self._clock.play(io.server, views, now).items():
            commands[arm] = target.commands()
        io.send(commands, views)
        io.topics.publish_judged(io.server, time.time_ns())
        io.reply()

    def _observe(self, step: int, views: dict[str, ArmView], now: int) -> None:
        io = self._io
        stamp_ns, problem = io.sources.add_arms(views)
        if stamp_ns is not None:
            observation = io.sources.observer.take(step, stamp_ns, io.server.wanted)
            if observation is not None:
                # As old as the oldest cycle or picture in it.
                oldest = min(at for at, _ in io.cycles.values()) - observation.behind
                io.server.observe(observation, oldest, now)
                return
            problem = io.sources.observer.missing(stamp_ns, io.server.wanted)
        io.server.observe_nothing(problem)
