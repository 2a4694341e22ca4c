"""A cell with its controllers in this process: a task without ROS.

The order of events is that of lock-step (docs/reference/conventions.md) and the controllers get the
same numbers, so one seed gives one state hash with and without ROS. In tick k the controllers step
with state k and the commands computed from tick k - 1. The world then steps with their answers and
the assistant's command to state k + 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import surg_core
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import FORCE_TICKS, GRID, TICK_NS
from surg_core.force.observed_force import PLACES, arm_force
from surg_sim.arrays import Array
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.patient_settings import PatientSetting, find_setting
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.stability import trouble
from surg_sim.physics.world import ArmState, World
from surg_sim.tasks import State, Task, Verdict, load
from surg_sim.tasks.scripted_sender import Action, Observation

Command = surg_core.MotionCommand | surg_core.StateCommand
"""To an arm in one tick: state commands are obeyed first, then motions in their order."""

SOURCE = 1
"""Whose commands the arm obeys: this process is one sender."""

LAWS = {
    "ours": surg_core.Law.EXACT,
    "velocity": surg_core.Law.VELOCITY,
    "paper": surg_core.Law.PAPER,
}
"""Names of the laws, as for ``./surg demo --law``."""


@dataclass(frozen=True)
class Tick:
    """What happened in one tick.

    Attributes:
        tick: Its number, from 1.
        outputs: Control cycle by arm.
        state: The task's ground truth at this tick; empty off the grid.
        verdict: How the episode stood at this tick, or why the simulation ended it after this tick.
    """

    tick: int
    outputs: Mapping[str, surg_core.Outputs]
    state: State
    verdict: Verdict

    def observation(self) -> Observation:
        """The same as a sender sees it."""
        arms = {name: ArmView.of(out) for name, out in self.outputs.items()}
        return Observation(tick=self.tick, arms=arms, task=self.state, phase=self.verdict.phase)


class CellSession:
    """Episodes of one task in one compiled scene.

    Args:
        cell: A loaded cell, or its path.
        task: A task, or what ``tasks.load`` takes.
        setting: Of ``patient_settings.SETTINGS``, or a condition of one's own.
        seed: Of the first episode, and of the look of the tissue.
        visuals: Build also what only pictures need; the physics is the same.
        law: Of ``LAWS``.

    Raises:
        ValueError: An unknown task, setting or law, or a cell that does not fit; says what does.
    """

    def __init__(
        self,
        cell: surg_core.Cell | Path | str,
        task: Task | str,
        setting: str | PatientSetting = "phantom",
        seed: int = 0,
        visuals: bool = False,
        law: str = "ours",
    ) -> None:
        if law not in LAWS:
            raise ValueError(f"no law '{law}': there are {', '.join(LAWS)}")
        self.cell = cell if isinstance(cell, surg_core.Cell) else surg_core.load_cell(cell)
        self.task = load(task) if isinstance(task, str) else task
        self.setting = find_setting(setting) if isinstance(setting, str) else setting
        self.law = law
        self.world = World(self.cell, seed, visuals, setting=self.setting, task=self.task)
        self._clearance = {
            name: surg_core.clearance_setup(self.cell, name, self.world.arms)
            for name in self.world.arms
        }
        self.seed = seed
        self._begin()

    def reset(self, seed: int) -> None:
        """Begin a new episode: everything as in a new process, except that nothing is compiled."""
        self.seed = seed
        self.world.reset(seed)
        self._begin()

    def _begin(self) -> None:
        self.controllers = {}
        for name in self.world.arms:
            arm = self.cell.arms[name]
            controller = surg_core.Controller(
                arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, law=LAWS[self.law],
                clearance=self._clearance[name],
            )  # fmt: skip
            controller.set_rcm(arm.trocar.p_BRcm)
            for fixture in arm.fixtures:
                controller.set_fixture(fixture)
            self.controllers[name] = controller
        self._forces: dict[str, dict[str, surg_core.ForceSample]] = {}
        self._earlier_forces: dict[str, dict[str, surg_core.ForceSample]] = {}

    @property
    def hash(self) -> str:
        """SHA-256 over the state of every tick of this episode."""
        return self.world.hash

    def tick(
        self,
        commands: Mapping[str, Sequence[Command]] | None = None,
        assistant: AssistantCommand | None = None,
    ) -> Tick:
        """One tick of 2 ms, with the commands to each arm and to the assistant's instrument."""
        world, tick = self.world, self.world.tick
        state = self.task.state() if tick % GRID == 0 else {}
        verdict = self.task.verdict()
        outputs, answers = {}, {}
        for name, controller in self.controllers.items():
            given = (commands or {}).get(name, ())
            for item in given:
                if isinstance(item, surg_core.StateCommand):
                    controller.request(item)
            motions = [item for item in given if isinstance(item, surg_core.MotionCommand)]
            measured = world.state(name)
            out = controller.step(
                measured.q, measured.qd, motions, measured.jaw,
                readings=self._readings(name, measured), others=self._others(name),
            )  # fmt: skip
            outputs[name] = out
            jaw = out.jaw_set if math.isfinite(out.jaw_set) else None
            turned = None if out.wrist is None else out.wrist.command
            answers[name] = ArmCommand(velocity=out.qd_command, jaw=jaw, wrist=turned)
            if tick % FORCE_TICKS == 0:
                self._earlier_forces[name] = self._forces.get(name, {})
                self._forces[name] = self._read_force_sensors(name)
        world.step(answers, assistant)
        unstable = trouble(world.data)
        if unstable:
            verdict = Verdict(done=True, reason=unstable, phase=verdict.phase)
        return Tick(tick, outputs, state, verdict)

    def observed_force(self, arm: str) -> list[float]:
        """The numbers of ``contract.ARM_FORCE`` as known at the last tick, which is on the grid.

        Forces of a tick count from the next one on: these are older, as in a graph.
        """
        samples = [self._earlier_forces.get(arm, {}).get(f"{place}_force") for place in PLACES]
        known = [None if s is None or not s.valid else np.asarray(s.f_B) for s in samples]
        return arm_force(known[0], known[1], self.told_R_BR(arm))

    def told_R_BR(self, arm: str) -> Array:
        """Orientation (3, 3) of the rcm frame as a graph tells it: a quaternion rounds it."""
        R_BR = np.asarray(self.controllers[arm].X_BR)[:3, :3]
        return surg_core.quaternion_xyzw_to_matrix(surg_core.matrix_to_quaternion_xyzw(R_BR))

    def _readings(self, arm: str, measured: ArmState) -> surg_core.Readings:
        """What a robot's link and its force sensors say beside the joints."""
        condition = self.world.link(arm).condition
        said: Mapping[str, Any] = self._forces.get(arm) or {}
        return surg_core.Readings(
            condition=condition,
            wrist=measured.wrist,
            wrist_rate=measured.wrist_velocity,
            **said,
        )

    def _others(self, name: str) -> list[surg_core.OtherArm]:
        """Where the arms are that an arm keeps clear of."""
        setup = self._clearance[name]
        states = [self.world.state(other.name) for other in (setup.others if setup else ())]
        return [surg_core.OtherArm(state.q, state.qd) for state in states]

    def _read_force_sensors(self, arm: str) -> dict[str, surg_core.ForceSample]:
        """What the force sensors of an arm measure now."""
        at_trocar = surg_core.ForceSample(self.world.truth(arm).trocar_force)
        tip = self.world.tip_force(arm)
        at_tip = surg_core.ForceSample() if tip is None else surg_core.ForceSample(tip)
        return {"trocar_force": at_trocar, "tip_force": at_tip}


def decode(commands: ArmCommands, tick: int) -> list[Command]:
    """An arm's commands for a tick as the controller node makes them of messages."""
    motion, kinds = surg_core.MotionCommand, surg_core.Motion
    stamp_ns = tick * TICK_NS
    decoded: list[Command] = []
    if commands.state is not None:
        decoded.append(getattr(surg_core.StateCommand, commands.state.upper()))
    if commands.hold:
        decoded.append(motion(kinds.HOLD, SOURCE))
    if commands.jaw is not None:
        decoded.append(motion(kinds.JAW_SERVO_JP, SOURCE, jaw=commands.jaw))
    if commands.servo_cp is not None:
        x, y, z, w = (float(v) for v in commands.servo_cp.q)
        norm = math.sqrt((x * x + z * z) + (y * y + w * w))  # summed as Eigen does in the node
        p, rotation = commands.servo_cp.p, np.array([x, y, z, w]) / norm
        decoded.append(motion(kinds.SERVO_CP, SOURCE, p=p, rotation=rotation, stamp_ns=stamp_ns))
    return decoded


def merge(
    actions: Sequence[Action], tick: int
) -> tuple[dict[str, list[Command]], AssistantCommand | None]:
    """Actions of several senders for a tick, in their order, for ``CellSession.tick``."""
    commands: dict[str, list[Command]] = {}
    assistant = None
    for each in actions:
        for arm, action in each.arms.items():
            commands.setdefault(arm, []).extend(decode(action, tick))
        assistant = each.assistant or assistant
    return commands, assistant
