"""An arm for programs that keep numbers by name, as LeRobot's robots do (src/surg_lerobot).

An observation is ``{"PSM1/tip_x.pos": 0.01, …, "endoscope.left": picture}``, an action
``{"PSM1/x.pos": 0.01, …}``. Names, units and frames are the server's.
"""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from surg_policy_client.adapters.scaled import scaled
from surg_policy_client.env import RemoteEnv
from surg_policy_client.errors import BadAction, Refused, SpecMismatch
from surg_policy_client.observation import STATE, Observation

PICTURES = "observation.images."
NUMBER = ".pos"
"""Ends the name of every number: lerobot-rollout passes on no others to a policy."""
STAY = 1.0
"""LeRobot's gripper command that moves nothing; 0 closes, 2 opens."""


class ArmByName:
    """The arms of a model server.

    Args:
        env: The connection.
        width: Of the pictures [px]; None: the server's.

    Attributes:
        env: The connection.
        pictures: Name of each camera → height, width, 3.
        observation_features: Name → ``float``, or the shape of a picture.
        action_features: Name → ``float``.
        refused: Steps that the server refused since the last observation: ``{"step": …, "rule": …,
            "text": …}``.

    Raises:
        SpecMismatch: The server names no numbers.
    """

    def __init__(self, env: RemoteEnv, width: int | None = None) -> None:
        state, action = env.spec.observation.get(STATE), env.spec.action
        if state is None or state.names is None or action is None:
            raise SpecMismatch(f"the server names no numbers of {STATE}, or no actions")
        self.env, self._action = env, action.names
        self.pictures = {
            key[len(PICTURES) :]: _of_width(feature.shape, width)
            for key, feature in env.spec.observation.items()
            if key.startswith(PICTURES) and feature.shape is not None
        }
        self._numbers = [name + NUMBER for name in state.names]
        self.observation_features: dict[str, Any] = dict.fromkeys(self._numbers, float)
        self.observation_features.update(self.pictures)
        self.action_features: dict[str, type] = {name + NUMBER: float for name in action.names}
        self.refused: list[dict[str, Any]] = []
        self._newest: Observation | None = None
        self._ack: Any = None
        self._led = False  # something was sent in this episode

    def begin(self) -> None:
        """Wait for an episode: until the policy is enabled.

        Raises:
            NoServer: None begins in time.
        """
        self._newest, info = self.env.reset()
        self._ack, self._led = info["acknowledged"], False

    def observe(self) -> dict[str, Any]:
        """Wait for the next observation; an episode in which nothing was sent may begin again.

        A program that still prepares itself when it is enabled is late; a person enables it again.

        Raises:
            Refused: The episode is over.
            NoServer: None comes; says why.
        """
        self._newest, _, over, broken_off, info = self.env.observe()
        if (over or broken_off) and not self._led:
            self.begin()
            self._newest, _, over, broken_off, info = self.env.observe()
        if over or broken_off:
            raise Refused("over", f"the episode is over: {info['reason'] or 'without a reason'}")
        ack, before = info["acknowledged"], self._ack
        self.refused, self._ack = ([] if ack is before else ack["rejected"]), ack
        seen: dict[str, Any] = dict(zip(self._numbers, map(float, self._newest[STATE])))
        for name, (height, width, _) in self.pictures.items():
            seen[name] = scaled(self._newest[PICTURES + name], height, width)
        return seen

    def send(self, action: Mapping[str, float]) -> None:
        """Send an action for the next grid time; it is held for one more if none follows.

        Raises:
            BadAction: A name is missing or strange, or a number is not finite. Nothing is sent.
        """
        if set(action) != set(self.action_features):
            raise BadAction(
                f"an action with {', '.join(sorted(action)) or 'nothing'}; it must have exactly "
                f"{', '.join(self.action_features)}"
            )
        self._led = True
        row = np.array([action[name] for name in self.action_features], np.float64)
        self.env.send(np.stack([row, row]))

    def nudged(
        self, hand: Mapping[str, float], step: float, turn: float, arm: str
    ) -> dict[str, float]:
        """The action that moves an arm on from where it is told to be; the other arms hold.

        Args:
            hand: Of a LeRobot teleoperator: ``delta_x``, ``delta_y``, ``delta_z`` (-1 to 1 along
                the axes of the rcm frame) and, if there is one, ``gripper`` (`STAY`).
            step: Way of a full deflection in one period [m].
            turn: Change of the jaw's angle in one period [rad].
            arm: Its name, such as ``PSM1``.

        Raises:
            RuntimeError: There was no observation so far.
            SpecMismatch: The server has no such arm.
        """
        if self._newest is None:
            raise RuntimeError("there is no observation; the robot must connect first")
        held = dict(zip(self._action, map(float, self._newest.held_action())))
        if f"{arm}/x" not in held:
            raise SpecMismatch(f"there is no arm {arm}; the server has {', '.join(self._action)}")
        for axis in "xyz":
            held[f"{arm}/{axis}"] += step * float(hand[f"delta_{axis}"])
        held[f"{arm}/jaw"] += turn * (float(hand.get("gripper", STAY)) - STAY)
        return {name + NUMBER: value for name, value in held.items()}


def _of_width(shape: tuple[int, ...], width: int | None) -> tuple[int, ...]:
    """Height, width, 3 of a picture that keeps its proportions."""
    tall, wide, colours = shape
    return shape if width is None else (tall * width // wide, width, colours)
