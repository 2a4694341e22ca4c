"""A simulated arm with a force sensor: its tip is pulled, its trocar breathes, its tip moves."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import surg_core
from helpers.force.force_bench import ForceBench
from helpers.force.statics import Array
from surg_cli.host import paths
from surg_core.force import load_solver
from surg_core.force.compensation import gravity_in_base
from surg_core.force.estimator import ForceEstimate, ForceEstimator
from surg_core.force.force_recording import read_forces
from surg_core.force.sensor_file import load_sensor
from surg_sim.physics.patient_settings import SETTINGS, PatientSetting
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.trocar_motion import Sinusoid
from surg_sim.physics.world import World

SENSOR = paths.ROOT / "src" / "surg_description" / "force_sensors" / "simulated.yaml"
TICK = 0.002
STALE = 10
"""Ticks by which a tracker of the trocar is late."""
SOURCE = 1
BREATHING = 0.003
"""[m] Amplitude of the trocar."""
INSIDE = 5.991
"""95 % of chi-squared with the two degrees of freedom across the shaft."""


def sensing_cell(name: str = "sim_ur5e") -> surg_core.Cell:
    """A bundled cell whose first arm has the bundled sensor."""
    cell = surg_core.load_cell(paths.ROOT / "cells" / name)
    arms = dict(cell.arms)
    first = next(iter(arms))
    arms[first] = dataclasses.replace(arms[first], force_sensor=SENSOR)
    return dataclasses.replace(cell, arms=arms)


def calibrated(cell: surg_core.Cell, folder: Path, seed: int = 1) -> load_solver.LoadFit:
    """The first arm's load, from 16 postures on the simulated bench."""
    arm = next(iter(cell.arms.values()))
    file = folder / "postures.csv"
    ForceBench(cell, arm.name, seed).record(file, 16)
    sensor = load_sensor(SENSOR)
    g_B = gravity_in_base(arm.X_WB[:3, :3])
    recording = read_forces(file, arm.chain, arm.robot.joint_names, g_B, sensor.sign)
    return load_solver.solve_load(recording.postures, sensor)


def inside(estimates: Sequence[ForceEstimate], errors: Sequence[Array], which: slice) -> float:
    """Share of errors (3,) that lie within 95 % of their estimates' covariance."""
    held = []
    for estimate, e in zip(estimates, errors, strict=True):
        assert estimate.covariance is not None
        C = estimate.covariance[which, which]
        held.append(e @ np.linalg.pinv(C, rcond=1e-6) @ e <= INSIDE)
    return float(np.mean(held))


def rms(errors: Sequence[Array]) -> float:
    """Root of the mean square of vectors."""
    return float(np.sqrt(np.mean([e @ e for e in errors])))


class RandomLoad:
    """A force on the tip [N] that goes by smooth steps to drawn values of at most 5 N."""

    def __init__(self, rng: np.random.Generator, most: float = 5.0) -> None:
        self._rng, self._most = rng, most
        self._from, self._to = np.zeros(3), np.zeros(3)
        self._begin, self._rise, self._end = 0.0, 1.0, 0.0

    def at(self, t: float) -> Array:
        """The force at a time [s] that does not go back."""
        if t >= self._end:
            u = self._rng.normal(size=3)
            self._from, self._begin = self._to, t
            self._to = self._rng.uniform(0, self._most) * u / np.linalg.norm(u)
            self._rise = self._rng.uniform(0.4, 1.5)
            self._end = t + self._rise + self._rng.uniform(0.0, 1.5)
        part = min(1.0, (t - self._begin) / self._rise)
        return self._from + (self._to - self._from) * (1.0 - np.cos(np.pi * part)) / 2.0


def pull_at_tip(world: World, tip: int, force: Array) -> None:
    """Pull at a body's origin; force (3,) in the world [N]. MuJoCo's own goes to its inertia's."""
    lever = world.data.xpos[tip] - world.data.xipos[tip]
    world.data.xfrc_applied[tip] = np.concatenate([force, np.cross(lever, force)])


@dataclass
class Row:
    """One estimate beside the truth at its own time and now; base axes [N]."""

    depth: float
    estimate: ForceEstimate
    tip: Array  # lateral, now
    trocar: Array  # of the surroundings on the shaft, lateral, now
    axial_tip: float
    age: float  # [s] of the estimate, from its stamp to now


class LoadedArm:
    """The first arm of a cell with its controller, in this process; see the module."""

    def __init__(
        self, cell: surg_core.Cell, fit: load_solver.LoadFit, seed: int, depth: float
    ) -> None:
        self.cell, self.arm = cell, next(iter(cell.arms.values()))
        self.rng = np.random.default_rng(seed)
        # The tool is calibrated as wrongly as that of the setting in vivo.
        setting = PatientSetting("test", tool_error=SETTINGS["in_vivo"].tool_error)
        self.world = World(cell, seed, arms=[self.arm.name], setting=setting)
        axis = self.rng.normal(size=3)
        motion = Sinusoid(BREATHING, 0.25, (axis[0], axis[1], axis[2]))
        self.world.trocar(self.arm.name).point.move(motion)
        arm = self.arm
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, track_rcm=True
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
        sensor = load_sensor(SENSOR)
        g_B = gravity_in_base(arm.X_WB[:3, :3])
        self.estimator = ForceEstimator(fit.load, sensor, arm.tool.s_F, arm.tool.p_FTip, g_B)
        self.load = RandomLoad(self.rng)
        self.depth = depth
        self.tip_id = self.world.model.body(f"{arm.name}_{arm.instrument.tip_link}").id
        self._begun = False
        self.state, self.warned = surg_core.State.DISABLED, False
        self.told: list[Array] = []

    def _wish(self, t: float) -> Array:
        """The tip in R: a slow motion in a cone about the home axis at the asked depth."""
        fade = min(1.0, t / 3.0)
        yaw = 0.2 * fade * np.sin(2 * np.pi * 0.13 * t)
        pitch = 0.2 * fade * np.sin(2 * np.pi * 0.17 * t)
        depth = self.depth * (1.0 + 0.08 * fade * np.sin(2 * np.pi * 0.11 * t))
        s = surg_core.shaft_direction(yaw, pitch)
        return np.asarray(depth * s)

    def tick(self, t: float, pull: bool, force_guard: bool = False) -> Row | None:
        """One tick; the estimate on every fifth. Before ``pull`` the tip is free."""
        arm, world = self.arm, self.world
        state = world.state(arm.name)
        out = self._control(t, state, force_guard)
        force = self.load.at(t) if pull else np.zeros(3)
        pull_at_tip(world, self.tip_id, arm.X_WB_stated[:3, :3] @ force)
        world.step({arm.name: ArmCommand(velocity=out.qd_command)})
        state = world.state(arm.name)
        X_BF = arm.chain.forward(state.q)
        twist = arm.chain.jacobian(state.q) @ state.qd
        reading = world.force_sensors[arm.name].reading
        self.estimator.add(t, reading, X_BF, twist, out.p_BRcm)
        s = X_BF[:3, :3] @ arm.tool.s_F
        across = np.eye(3) - np.outer(s, s)
        if world.tick % 5 or not pull:
            return None
        estimate = self.estimator.estimate()
        trocar = -world.trocar(arm.name).force
        return Row(
            float(out.depth), estimate, across @ force, across @ trocar, float(s @ force),
            t - estimate.stamp,
        )  # fmt: skip

    def _control(self, t: float, state: object, force_guard: bool) -> surg_core.Outputs:
        assert isinstance(state, type(self.world.state(self.arm.name)))
        tick, p, v = self.world.trocar(self.arm.name).point.observed(STALE)
        age = (self.world.tick - tick) * TICK
        forces = self._guarded() if force_guard else {}
        readings = surg_core.Readings(p_BTrack=p, v_BTrack=v, track_age=age, **forces)
        if not self._begun:
            commands = []
        else:
            wish = self._wish(t)
            commands = [
                surg_core.MotionCommand(
                    surg_core.Motion.SERVO_CP, SOURCE, p=wish,
                    rotation=surg_core.tip_quaternion(wish, 0.0),
                )
            ]  # fmt: skip
        out = self.controller.step(state.q, state.qd, commands, 0.0, readings=readings)
        self.state = out.state
        self.warned |= bool(out.warn_force)
        if self.world.tick == 5:
            assert self.controller.request(surg_core.StateCommand.HOME) == surg_core.Reason.NONE
            assert self.controller.request(surg_core.StateCommand.ENABLE) == surg_core.Reason.NONE
        return out

    def begin(self) -> None:
        """Home, enable, and move to the first wish."""
        for k in range(20):
            self.tick(-10.0 + k * TICK, False)
        goal = self._wish(0.0)
        command = surg_core.MotionCommand(
            surg_core.Motion.MOVE_CP, SOURCE, p=goal, rotation=surg_core.tip_quaternion(goal, 0.0)
        )
        moves = [command]
        for _ in range(4000):
            state = self.world.state(self.arm.name)
            tick, p, v = self.world.trocar(self.arm.name).point.observed(STALE)
            readings = surg_core.Readings(
                p_BTrack=p, v_BTrack=v, track_age=(self.world.tick - tick) * TICK
            )
            out = self.controller.step(state.q, state.qd, moves, 0.0, readings=readings)
            self.world.step({self.arm.name: ArmCommand(velocity=out.qd_command)})
            self.state = out.state
            assert not out.verdicts or out.verdicts[0].reason == surg_core.Reason.NONE
            if not moves and not out.busy:
                break
            moves = []
        self._begun = True

    def _guarded(self) -> dict[str, surg_core.ForceSample]:
        """What the force guard would be told now."""
        estimate = self.estimator.estimate()
        if not estimate.valid or estimate.forces is None:
            return {}
        f = estimate.forces
        self.told = [f.tip + f.axial * f.s, f.trocar]
        return {
            "tip_force": surg_core.ForceSample(f.tip + f.axial * f.s),
            "trocar_force": surg_core.ForceSample(-f.trocar),
        }
