"""What an environment observes and takes: names, spaces and values of a session's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from surg_core.action_space import (
    ABSOLUTE,
    ActionSpace,
    absolute_range,
    commands_of,
    target_of,
    wrist_of_arm,
)
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import ARM_FORCE, STEP, VIRTUAL_JOINTS, arm_state
from surg_sim.arrays import Array
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.tasks.scripted_sender import home_frame

ASSISTANT_STATE = (*VIRTUAL_JOINTS, "jaw")
"""Of the assistant's instrument in ``state`` [rad, rad, m, rad, rad], where there is one."""


class EnvSpaces:
    """Spaces of a session, with pictures of these views and of this size (width, height) [px].

    ``forces``: the commanded arms' forces at tip and trocar are observed. ``space``: that of the
    actions, of ``contract.ACTION_SPACES``.
    """

    def __init__(
        self,
        session: CellSession,
        images: Sequence[str],
        size: tuple[int, int],
        forces: bool = False,
        space: str = ABSOLUTE,
    ) -> None:
        self._session, self._images, self._size, self._forces = session, images, size, forces
        self.arms = session.task.commanded
        """Arms that the action commands, in its order."""
        self._R_BHome = {
            name: np.asarray(arm.X_WB)[:3, :3].T @ home_frame(arm)[:3, :3]
            for name, arm in session.cell.arms.items()
        }
        wrists = {arm: wrist_of_arm(session.cell.arms[arm]) for arm in session.world.arms}
        self.state_names = [
            f"{arm}/{name}"
            for arm, wrist in wrists.items()
            for name in arm_state(wrist is not None)[0]
        ]
        """Names of the numbers in ``state``, such as ``PSM1/tip_x``."""
        if session.task.assistant is not None:
            self.state_names += [f"assistant/{name}" for name in ASSISTANT_STATE]
        self.force_names = [f"{arm}/{name}" for arm in self.arms for name in ARM_FORCE]
        """Names of the numbers in ``force``, such as ``PSM1/tip_x``."""
        self._space = ActionSpace(space, tuple(wrists[arm] for arm in self.arms))
        self.action_names = list(self._space.columns(self.arms))
        """Names of the numbers of an action, such as ``PSM1/x``."""

    def action(self) -> spaces.Box:
        """Of every commanded arm, rcm frame; bounds are those of absolute actions [m, rad]."""
        if self._space.name != ABSOLUTE:
            return spaces.Box(-np.inf, np.inf, (len(self.action_names),), np.float64)
        ranges = [absolute_range(self._session.cell.arms[name]) for name in self.arms]
        low, high = (np.concatenate(ends) for ends in zip(*ranges, strict=True))
        return spaces.Box(low, high, dtype=np.float64)

    def observation(self) -> spaces.Dict:
        """``state``, ``privileged`` and, where they are asked for, ``force`` and ``images``."""

        def free(shape: tuple[int, ...]) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, shape, np.float64)

        task = self._session.task.state()
        members: dict[str, spaces.Space[Any]] = {
            "state": free((len(self.state_names),)),
            "privileged": spaces.Dict({key: free(np.shape(task[key])) for key in task}),
        }
        if self._forces:
            members["force"] = free((len(self.force_names),))
        if self._images:
            width, height = self._size
            picture = spaces.Box(0, 255, (height, width, 3), np.uint8)
            members["images"] = spaces.Dict(dict.fromkeys(self._images, picture))
        return spaces.Dict(members)

    def observe(self, tick: Tick) -> dict[str, Any]:
        """``state``, ``privileged`` and, if asked for, ``force`` of a tick."""
        task = self._session.task
        state: list[float] = []
        for arm in tick.outputs:
            state += self._view(arm, tick).numbers
        if task.assistant is not None:
            state += [*task.assistant.joints, task.assistant.jaw]
        truth = tick.state or task.state()
        privileged = {key: np.asarray(truth[key], dtype=np.float64) for key in truth}
        seen: dict[str, Any] = {"state": np.array(state), "privileged": privileged}
        if self._forces:
            felt = [self._session.observed_force(arm) for arm in self.arms]
            seen["force"] = np.concatenate(felt)
        return seen

    def _view(self, arm: str, tick: Tick) -> ArmView:
        """An arm in its rcm frame; before homing in that of its home posture."""
        out = tick.outputs[arm]
        R_BR = np.asarray(self._session.controllers[arm].X_BR)[:3, :3]
        return ArmView.of(out, R_BR if out.homed else self._R_BHome[arm])

    def commands(self, action: Array, tick: Tick) -> dict[str, ArmCommands]:
        """An action as commands by arm, after a tick.

        Raises:
            ValueError: The action has the wrong length, is not finite, or is a pose that no wrist
                can have.
        """
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (len(self.action_names),) or not np.isfinite(values).all():
            raise ValueError(
                f"action {values.tolist()}: {len(self.action_names)} finite numbers are needed: "
                f"{', '.join(self.action_names)}"
            )
        views = {arm: self._view(arm, tick) for arm in self.arms}
        space, before = self._in_force(views)
        targets = space.split(space.decode(values[None], before, STEP)[0])
        wrists = space.wrists or (None,) * len(views)
        commands = {}
        for (arm, view), wrist, target in zip(views.items(), wrists, targets, strict=True):
            if not np.isfinite(target).all():
                raise ValueError(f"action {values.tolist()}: no wrist of {arm} can be there")
            if view.p_BSample is None:
                slack = self._session.cell.arms[arm].limits.step_slack
                target[:3] = view.first_step(target[:3], slack)
            commands[arm] = commands_of(wrist, target)
        return commands

    def action_of(self, commands: Mapping[str, ArmCommands], tick: Tick) -> Array:
        """The action that a sender's commands are after a tick, the inverse of ``commands``.

        Raises:
            RuntimeError: An arm is told no pose.
        """
        views = {arm: self._view(arm, tick) for arm in self.arms}
        space, before = self._in_force(views)
        targets = []
        for arm, view in views.items():
            said = commands.get(arm)
            if said is None or said.servo_cp is None:
                raise RuntimeError(f"there is no motion for {arm}")
            jaw = view.jaw_set if said.jaw is None else said.jaw
            targets.append(target_of(view.wrist_geometry, said.servo_cp, jaw, view.roll_go_on))
        return space.encode(np.concatenate(targets)[None], before[None], STEP)[0]

    def _in_force(self, views: Mapping[str, ArmView]) -> tuple[ActionSpace, Array]:
        """The space with the wrists as they are mounted, and the targets in force."""
        wrists = tuple(view.wrist_geometry for view in views.values())
        before = np.concatenate([view.target_in_force for view in views.values()])
        return ActionSpace(self._space.name, wrists), before
