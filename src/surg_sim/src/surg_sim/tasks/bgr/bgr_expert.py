"""The two scripts of bowel grasping and retraction."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import surg_core
from surg_core.contract import STEP
from surg_core.transforms import minimal_rotation, virtual_joints
from surg_sim.arrays import Array
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.tissue_grasp import GRIP_DEPTH
from surg_sim.tasks.bgr.bgr_definition import PHASES, ROBOT, TAUT
from surg_sim.tasks.scripted_arm import ArmExpert
from surg_sim.tasks.scripted_sender import Action, MinimumJerk, Observation, ScriptedExpert

UP = np.array([0.0, 0.0, 1.0])
OPEN, CLOSED = 0.68, 0.0
"""Jaw angles [rad]."""
ABOVE = 0.030
"""From here the jaws go down to the tissue [m]."""
APART = 5
"""Number of nodes from the target to the node that the assistant grasps."""
GRIP_HEIGHT = 0.006
"""Of the grip above the axis of the bowel [m]."""
POINT_HEIGHT = 0.016
"""Of the pointing tip above the axis of the bowel [m]."""
ATTEMPTS = 4
"""Jaws that close on nothing open again, rise, and try deeper, so often."""
DEEPER, AGAIN = 0.0015, 0.015
"""Each attempt goes so much deeper, and begins so far above [m]."""
LIFT = 0.020
"""Of both holds [m]."""
PULL = 1.6 * TAUT
"""Tension at which the robot stops pulling [N]."""
PULL_SPEED, PULL_MOST = 0.010, 0.045
"""[m/s], [m]"""


def along(nodes: Array, i: int) -> Array:
    """Direction of the tube at a node, unit vector (3,)."""
    t = nodes[min(i + 1, len(nodes) - 1)] - nodes[max(i - 1, 0)]
    return np.asarray(t / np.linalg.norm(t))


def roll_across(s: Array, y: Array, tangent: Array) -> float:
    """Smaller of the two rolls that make jaws open across a tube [rad].

    All (3,): the shaft axis s, y where the jaws open to at roll 0, perpendicular to s, and the
    tube's direction.
    """
    n = np.cross(s, tangent)
    angle = math.atan2(float(np.cross(y, n) @ s), float(y @ n))
    return (angle + math.pi / 2) % math.pi - math.pi / 2


def until(expert: ScriptedExpert, phase: str) -> Iterator[None]:
    """Wait for a phase, or a later one."""
    while PHASES.index(expert.observation.phase) < PHASES.index(phase):
        yield


def take(
    expert: ScriptedExpert, node: int, grip: Array, s_W: Array, error: Array, held: str
) -> Iterator[None]:
    """Close the jaws on a node until the task's number ``held`` says that it is held.

    The tip goes ``grip`` (3,) [m] from the node, along the shaft s_W (3,); half of the hand's error
    (3,) [m] is corrected after each attempt, for a second look is a better one.
    """
    for attempt in range(ATTEMPTS):
        place = expert.observation.point("nodes")[node]
        yield from expert.move(place + grip - attempt * DEEPER * UP, 1.0)
        yield from expert.squeeze(CLOSED, 0.6)
        if expert.observation.number(held) >= 0.0:
            return
        yield from expert.squeeze(OPEN, 0.3)
        yield from expert.move(place + grip - AGAIN * s_W, 0.5)
        grip = grip - 0.5 * error


class RobotExpert(ArmExpert):
    """At the robot's console."""

    def __init__(self, cell: surg_core.Cell, seed: int) -> None:
        super().__init__(cell, seed, ROBOT)
        self._error = self.rng.normal(scale=1e-3, size=3)  # of the hand, at the tissue [m]
        self._reaction = float(self.rng.uniform(0.2, 0.6))

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        yield from until(self, "grasp")
        yield from self.wait(self._reaction)
        self.jaw = OPEN
        node = int(self.observation.number("target"))
        place = self.observation.point("nodes")[node]
        direction = place - self.X_WR[:3, 3]
        s = direction / np.linalg.norm(direction)
        y = minimal_rotation(self.X_WR[:3, 2], s) @ self.X_WR[:3, 1]
        self.roll.go(np.array([roll_across(s, y, along(self.observation.point("nodes"), node))]))
        error = self.expert_noise * self._error
        grip = GRIP_HEIGHT * UP + GRIP_DEPTH * s + error
        yield from self.move(place + grip - ABOVE * s, 1.0)
        while not self.roll.arrived:
            yield
        yield from take(self, node, grip, s, error, "held")
        yield from until(self, "retract")
        yield from self.wait(self._reaction)
        yield from self.move(self.observation.point("tip") + LIFT * UP, 1.5)
        away = self.observation.point("tip") - self.observation.point("assistant_tip")
        away -= (away @ UP) * UP
        away /= np.linalg.norm(away)
        pulled, tip, pulling = 0.0, self.observation.point("tip"), True
        while pulled < PULL_MOST:  # taut in passing is not taut: what slackens is pulled again
            pulling = self.observation.number("tension") < (PULL if pulling else TAUT)
            if pulling:
                pulled += PULL_SPEED * STEP
                self.path.stay(self.local(tip + pulled * away))
            yield


class AssistantExpert(ScriptedExpert):
    """At the assistant's instrument: points, waits, takes its own hold, lifts."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 1])
        self._reaction = self.rng.uniform(0.2, 0.8, size=3)
        self._error = self.rng.normal(scale=1.5e-3, size=(2, 3))
        self.jaw = CLOSED
        self.path = MinimumJerk(np.zeros(3), 0.06, 0.3)
        self.roll = MinimumJerk(np.zeros(1), 1.5, 6.0)
        self._script: Iterator[None] | None = None

    def act(self, observation: Observation) -> Action:
        """See :class:`Expert`."""
        self.observation = observation
        if self._script is None:
            self.X_WR = observation.point("X_WAssistant")
            self.path.stay(self.local(observation.point("assistant_tip")))
            self.roll.stay(observation.point("assistant_joints")[3:])
            self._script = self.script()
        next(self._script, None)
        joints = virtual_joints(self.path.advance(STEP), float(self.roll.advance(STEP)[0]))
        return Action(assistant=AssistantCommand(joints=joints, jaw=self.jaw))

    def script(self) -> Iterator[None]:
        """What it does, action by action."""
        yield from self.wait(self._reaction[0])
        node = int(self.observation.number("target"))
        nodes = self.observation.point("nodes")
        side = -along(nodes, node) * 0.006  # beside the place, so that the robot gets at it
        yield from self.move(nodes[node] + POINT_HEIGHT * UP + side + self._error[0])
        yield from until(self, "grasp")
        yield from self.wait(self._reaction[1])
        mine = node - APART
        self.jaw = OPEN
        nodes = self.observation.point("nodes")
        p = self.local(nodes[mine])
        s = p / np.linalg.norm(p)
        s_W = self.X_WR[:3, :3] @ s
        y = minimal_rotation(np.array([0.0, 0.0, 1.0]), s) @ np.array([0.0, 1.0, 0.0])
        self.roll.go(np.array([roll_across(s, y, self.X_WR[:3, :3].T @ along(nodes, mine))]))
        grip = GRIP_HEIGHT * UP + GRIP_DEPTH * s_W + self._error[1]
        above = grip - ABOVE * s_W
        yield from self.move(nodes[mine] + above)
        yield from until(self, "assist")
        yield from self.wait(self._reaction[2])
        yield from take(self, mine, grip, s_W, self._error[1], "assistant_held")
        yield from until(self, "retract")
        yield from self.move(self.observation.point("assistant_tip") + LIFT * UP, 1.5)
