"""Runs an episode in this process and measures it.

The deviations are counted from the first motion command on, as the paper does: while the arm is
being homed it does not move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from surg_core.contract import GRID, TICK
from surg_sim.arrays import Array
from surg_sim.envs.cell_session import CellSession, Tick, merge
from surg_sim.tasks.scripted_sender import Expert

_Sample = tuple[float, float, float, float]  # kinematic, true, force, displacement


@dataclass(frozen=True)
class Spread:
    """Mean and largest value over an episode."""

    mean: float
    max: float

    @classmethod
    def of(cls, values: Array) -> Spread:
        """Of samples (n,); not a number where there are none."""
        if len(values) == 0:
            return cls(float("nan"), float("nan"))
        return cls(float(np.mean(values)), float(np.max(values)))


@dataclass(frozen=True)
class ArmReport:
    """What one arm did to its trocar; SI."""

    kinematic: Spread  # distance of the commanded pivot to the shaft by joint states: the paper's
    true: Spread  # distance of the undisturbed trocar point to the true shaft axis
    force: Spread  # of the shaft on the wall
    displacement: Spread  # of the wall's hole from its undisturbed point


@dataclass(frozen=True)
class EpisodeReport:
    """One episode."""

    seed: int  # its seed
    success: bool  # whether it was one
    reason: str  # why not; empty after a success
    duration: float  # [s] of simulated time
    reward: float  # sum over the episode
    arms: Mapping[str, ArmReport]  # by name
    hash: str  # of the states of all ticks


def run_episode(
    session: CellSession,
    seed: int,
    experts: Mapping[str, Expert] | None = None,
    watch: Callable[[Tick], None] | None = None,
) -> EpisodeReport:
    """Run one episode of a session, which is reset, to its end; ``watch`` sees every tick.

    Experts are senders by node name; None: those of the task; empty: nobody does anything.
    """
    session.reset(seed)
    if experts is None:
        experts = session.task.experts(session.cell, seed)
    senders = [experts[name] for name in sorted(experts)]
    commands, assistant = merge([], 0)
    samples: dict[str, list[_Sample]] = {name: [] for name in session.world.arms}
    reward = 0.0
    while True:
        tick = session.tick(commands, assistant)
        reward += tick.verdict.reward
        for name, rows in samples.items():
            if int(tick.outputs[name].accepted) > 0:
                truth = session.world.truth(name)
                force, displacement = map(np.linalg.norm, (truth.trocar_force, truth.displacement))
                kinematic = tick.outputs[name].rcm_error
                rows.append((kinematic, truth.deviation, float(force), float(displacement)))
        if watch is not None:
            watch(tick)
        if tick.verdict.done:
            break
        actions = []
        if tick.tick % GRID == 0:
            observation = tick.observation()
            actions = [sender.tick(observation) for sender in senders]
        commands, assistant = merge(actions, tick.tick + 1)
    return EpisodeReport(
        seed=seed,
        success=tick.verdict.success,
        reason=tick.verdict.reason,
        duration=tick.tick * TICK,
        reward=reward,
        arms={
            name: ArmReport(*map(Spread.of, np.array(rows).reshape(-1, 4).T))
            for name, rows in samples.items()
        },
        hash=session.hash,
    )
