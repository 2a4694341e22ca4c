"""Observations and actions of scripted experts, and the minimum-jerk motion they share.

An expert acts at 20 Hz. Each target is the set-point at the next grid time, on a minimum-jerk
profile within the limits; it is never a distant goal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

import surg_core
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import GRID, STEP
from surg_sim.arrays import Array

if TYPE_CHECKING:
    from surg_sim.physics.assistant_arm import AssistantCommand


SETTLED = 0.15
"""Time after which an instrument has reached its resting set-point [s]."""


@dataclass(frozen=True)
class Observation:
    """Everything that an expert sees of tick k.

    Attributes:
        tick: k.
        arms: By name.
        task: The task's ground truth at k.
        phase: The task's phase at k.
    """

    tick: int
    arms: Mapping[str, ArmView]
    task: Mapping[str, float | Array]
    phase: str

    def point(self, name: str) -> Array:
        """A vector of the task's state."""
        return np.asarray(self.task[name], dtype=np.float64)

    def number(self, name: str) -> float:
        """A number of the task's state."""
        return float(np.asarray(self.task[name]))


@dataclass
class Action:
    """Commands of an expert for one tick.

    Attributes:
        arms: Commands by arm.
        assistant: Command to the assistant's instrument.
    """

    arms: dict[str, ArmCommands] = field(default_factory=dict)
    assistant: AssistantCommand | None = None


class Expert(ABC):
    """A scripted expert.

    Attributes:
        arms: Arms that it observes and commands.
        reason: Why it gave up; empty otherwise.
    """

    arms: tuple[str, ...] = ()
    reason: str = ""

    def tick(self, observation: Observation) -> Action:
        """Action for tick k + 1; empty off the 20 Hz grid."""
        return self.act(observation) if observation.tick % GRID == 0 else Action()

    @abstractmethod
    def act(self, observation: Observation) -> Action:
        """Action for an observation; called for consecutive grid ticks."""


def home_frame(arm: surg_core.Arm) -> Array:
    """The rcm frame of an arm that is homed at its home posture, in the world, (4, 4).

    An expert knows the cell but not the encoder noise at homing; the two frames differ by that.
    """
    R_BF = np.asarray(arm.chain.forward(np.asarray(arm.robot.home)))[:3, :3]
    s_home = R_BF @ np.asarray(arm.tool.s_F)
    X_BR = np.asarray(surg_core.rcm_frame(s_home, np.asarray(arm.trocar.p_BRcm)))
    return np.asarray(arm.X_WB @ X_BR)


def into(X: Array, p: Array) -> Array:
    """A point of the outer frame in the frame X (4, 4): X^-1 p."""
    return np.asarray(X[:3, :3].T @ (p - X[:3, 3]))


def out_of(X: Array, p: Array) -> Array:
    """A point of the frame X (4, 4) in the outer frame: X p."""
    return np.asarray(X[:3, :3] @ p + X[:3, 3])


class MinimumJerk:
    """A coordinate vector (n,) that moves along minimum-jerk profiles, from rest to rest.

    s(u) = 10 u^3 - 15 u^4 + 6 u^5: the velocity peaks at 1.875 of the mean, the acceleration at
    5.774 distance / duration^2. The duration is the shortest that keeps both limits, each of all
    coordinates or (n,).
    """

    def __init__(self, start: Array, velocity: Array | float, acceleration: Array | float) -> None:
        self._velocity, self._acceleration = velocity, acceleration
        self.stay(start)

    def stay(self, at: Array) -> None:
        """Set the value and be at rest."""
        self._from = self._to = self.at = np.array(at, dtype=np.float64)
        self._duration = self._time = 0.0

    def go(self, target: Array, slowest: float = 0.0) -> None:
        """Start towards a target; take at least ``slowest`` [s]."""
        self._from, self._to = self.at, np.array(target, dtype=np.float64)
        way = np.abs(self._to - self._from)
        needed = np.maximum(1.875 * way / self._velocity, np.sqrt(5.774 * way / self._acceleration))
        self._duration = max(float(needed.max()), slowest)
        self._time = 0.0

    @property
    def goal(self) -> Array:
        """Final value."""
        return self._to

    @property
    def arrived(self) -> bool:
        """Whether the value is at rest."""
        return self._time >= self._duration

    def advance(self, dt: float) -> Array:
        """Value after another dt [s], (n,)."""
        self._time = min(self._time + dt, self._duration)
        u = self._time / self._duration if self._duration > 0.0 else 1.0
        s = u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
        self.at = self._from + s * (self._to - self._from) if u < 1.0 else self._to
        return self.at


class ScriptedExpert(Expert):
    """An expert with a script: a generator that moves ``path``, ``roll`` and ``jaw``.

    Attributes:
        observation: The newest one.
        X_WR: Frame of the path in the world, (4, 4).
        path: Motion of the tip [m].
        roll: Motion of the roll [rad].
        jaw: Jaw angle to send [rad]; None: no command.
    """

    observation: Observation
    X_WR: Array
    path: MinimumJerk
    roll: MinimumJerk
    jaw: float | None = None

    @abstractmethod
    def script(self) -> Iterator[None]:
        """Moves ``path``, ``roll`` and ``jaw``; yields once per action."""

    def local(self, p_W: Array) -> Array:
        """A point of the world in the frame of the path [m], (3,)."""
        return into(self.X_WR, p_W)

    def wait(self, seconds: float) -> Iterator[None]:
        """Wait."""
        for _ in range(max(1, round(seconds / STEP))):
            yield

    def move(self, p_W: Array, slowest: float = 0.0) -> Iterator[None]:
        """Bring the tip to a point of the world [m], in at least ``slowest`` [s]."""
        self.path.go(self.local(p_W), slowest)
        while not self.path.arrived:
            yield
        yield from self.wait(SETTLED)

    def squeeze(self, angle: float, seconds: float) -> Iterator[None]:
        """Bring the jaws to an angle [rad] and wait."""
        self.jaw = angle
        yield from self.wait(seconds)
