"""The simulated world: one tick in, one state out. No ROS, no clock, no threads.

Tick k lasts 2 ms; its stamp is exactly k * 2,000,000 ns. After ``reset`` the world is at tick 1.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

import surg_core
from surg_sim.appearance.lens import EndoscopeLens
from surg_sim.arrays import Array
from surg_sim.physics import scene
from surg_sim.physics.ground_truth import ArmTruth, TruthReader
from surg_sim.physics.patient_settings import PatientSetting
from surg_sim.physics.pose_error import with_base_error
from surg_sim.physics.sim_arm import SUBSTEPS, ArmCommand, ArmLink, ToolError
from surg_sim.physics.tool_drive import ToolDrive, WristDrive
from surg_sim.physics.trocar import Trocar, TrocarParameters
from surg_sim.sensing.flange_sensor import FlangeSensor, sensor_of

if TYPE_CHECKING:
    from surg_sim.physics.assistant_arm import AssistantCommand
    from surg_sim.tasks.task import Task


_NOTHING = ArmCommand()


@dataclass(frozen=True)
class ArmState:
    """What an arm's links measure at one tick."""

    q: Array  # (n,) joint positions [rad]
    qd: Array  # (n,) joint velocities [rad/s]
    jaw: float  # jaw angle [rad]
    jaw_velocity: float  # [rad/s]
    wrist: Array | None = None  # (n,) see `wrist_joints` [rad]; None: has no wrist
    wrist_velocity: Array | None = None  # (n,) [rad/s]


@dataclass
class _Member:
    """The parts of one arm."""

    link: ArmLink
    jaw: ToolDrive
    wrist: WristDrive | None
    trocar: Trocar
    truth: TruthReader


class World:
    """A cell in MuJoCo, advanced tick by tick; the same commands give the same bits.

    Args:
        cell: A loaded cell.
        seed: Seed of the look of the tissue and of the first episode.
        visuals: Add patient and room for pictures; the physics is the same.
        arms: Names of the arms to simulate; None: all of the cell.
        trocar: Wall; None: the setting's.
        tool_errors: Calibration error by arm name; None: the setting's.
        setting: Physical parameters; None: the defaults, without breathing.
        task: Task to perform; None: none.

    Raises:
        ValueError: An arm is not in the cell, or a URDF does not fit its YAML.
    """

    def __init__(
        self,
        cell: surg_core.Cell,
        seed: int = 0,
        visuals: bool = False,
        arms: Iterable[str] | None = None,
        trocar: TrocarParameters | None = None,
        tool_errors: Mapping[str, ToolError] | None = None,
        setting: PatientSetting | None = None,
        task: Task | None = None,
    ) -> None:
        if setting is not None:
            trocar = trocar or setting.trocar
            if tool_errors is None and setting.tool_error is not None:
                tool_errors = dict.fromkeys(cell.arms, setting.tool_error)
        trocar = trocar or TrocarParameters()
        self._setting = setting
        if task is not None:
            task.prepare(cell, setting or PatientSetting(name="default"))
        built = with_base_error(cell, None if setting is None else setting.base_error)
        chosen = scene.choose_arms(built, arms)
        self.cell, self.task, self._seed = built, task, seed

        def add(spec: mujoco.MjSpec, site: scene.Site) -> None:
            if task is not None:
                task.add(spec, site, visuals)

        camera_error = None if setting is None else setting.camera_error
        self.model = scene.build(chosen, seed, visuals, trocar, tool_errors, camera_error, add)
        self.data = mujoco.MjData(self.model)
        self._R_WB = {arm.name: np.asarray(arm.X_WB_stated)[:3, :3] for arm in chosen}
        self._members: dict[str, _Member] = {}
        for arm in chosen:
            wrist = arm.instrument.wrist
            sleeve = Trocar(self.model, self.data, arm, trocar)
            self._members[arm.name] = _Member(
                link=ArmLink(self.model, self.data, arm),
                jaw=ToolDrive(self.model, self.data, arm),
                wrist=WristDrive(self.model, self.data, arm, wrist) if wrist else None,
                trocar=sleeve,
                truth=TruthReader(self.model, self.data, arm, sleeve),
            )
        self.force_sensors = {
            arm.name: FlangeSensor(self.model, self.data, arm, sensor, seed)
            for arm in chosen
            if (sensor := sensor_of(arm)) is not None
        }
        """Sensors between flange and tool, by arm; read in every tick."""
        if task is not None:
            task.bind(self)
        self.reset()

    @property
    def endoscope_lens(self) -> EndoscopeLens:
        """The true lens of each eye of the endoscope; a pinhole unless the setting has one."""
        return EndoscopeLens() if self._setting is None else self._setting.lens

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the simulated arms."""
        return tuple(self._members)

    def reset(self, seed: int | None = None) -> None:
        """Home posture at rest, tick 1, fresh hash, a new episode of the task drawn by the seed.

        None: the seed that the world was made with.
        """
        mujoco.mj_resetData(self.model, self.data)
        for member in self._members.values():
            member.link.reset()
            member.jaw.reset()
            if member.wrist is not None:
                member.wrist.reset()
        mujoco.mj_kinematics(self.model, self.data)
        for member in self._members.values():
            member.trocar.reset()
        if self._setting is not None:
            for name, member in self._members.items():
                member.trocar.point.move(self._setting.breathing.wall(self._R_WB[name]))
        if self.task is not None:
            self.task.reset(np.random.default_rng(self._seed if seed is None else seed))
        mujoco.mj_forward(self.model, self.data)
        for sensor in self.force_sensors.values():
            sensor.reset(seed)
        self.tick = 1
        self._hash = hashlib.sha256()

    def step(
        self, commands: Mapping[str, ArmCommand], assistant: AssistantCommand | None = None
    ) -> None:
        """Execute one tick: take the commands that answer its state, then 2 x 1 ms of physics.

        An arm without a command received nothing, as does the assistant's instrument with None.
        """
        for name, member in self._members.items():
            command = commands.get(name, _NOTHING)
            member.link.accept(command)
            member.jaw.accept(command.jaw)
            if member.wrist is not None:
                member.wrist.accept(command.wrist)
            member.trocar.advance()
        if self.task is not None:
            if self.task.assistant is not None:
                self.task.assistant.accept(assistant)
            self.task.advance()
        # mj_step is step1 (positions, velocities) then step2 (forces, integration). Ending on step1
        # leaves kinematics that belong to the new state, at no extra cost.
        for substep in range(SUBSTEPS):
            for member in self._members.values():
                member.link.substep()
            mujoco.mj_step2(self.model, self.data)
            if self.force_sensors and substep == SUBSTEPS - 1:
                self._sample_forces()  # accelerations and contact forces are this step's
            mujoco.mj_step1(self.model, self.data)
        self.tick += 1
        self._hash.update(self.data.qpos.tobytes())
        self._hash.update(self.data.qvel.tobytes())

    def _sample_forces(self) -> None:
        mujoco.mj_rnePostConstraint(self.model, self.data)
        for sensor in self.force_sensors.values():
            sensor.sample()

    def state(self, arm: str) -> ArmState:
        """What the links of an arm measure now."""
        member = self._members[arm]
        q, step = member.link.q, self._setting.encoder if self._setting else 0.0
        if step > 0.0:
            q = np.rint(q / step) * step
        jaw, wrist = member.jaw, member.wrist
        turned = () if wrist is None else (wrist.angles, wrist.rates)
        return ArmState(q, member.link.qd, jaw.angle, jaw.velocity, *turned)

    def truth(self, arm: str) -> ArmTruth:
        """The truth of an arm now."""
        member = self._members[arm]
        return member.truth.read(member.jaw.angle)

    def tip_force(self, arm: str) -> Array | None:
        """Force on the instrument's jaws, base frame [N], (3,); None: no sensor.

        There is a sensor if the task provides ``jaw_force``.
        """
        force = None if self.task is None else self.task.jaw_force(arm)
        return None if force is None else self._R_WB[arm].T @ force

    def link(self, arm: str) -> ArmLink:
        """Robot link of an arm, with its dead-man timer and fault."""
        return self._members[arm].link

    def trocar(self, arm: str) -> Trocar:
        """Trocar of an arm."""
        return self._members[arm].trocar

    @property
    def hash(self) -> str:
        """SHA-256 over float64 qpos, qvel of every tick since ``reset``, as hex digits."""
        return self._hash.hexdigest()
