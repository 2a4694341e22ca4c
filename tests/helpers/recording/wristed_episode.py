"""A recorded episode of a wristed arm in the simulator, with the simulator's truth beside it."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import surg_core
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, TipPose
from surg_core.bring_up import BringUp
from surg_core.contract import TICK, TICK_NS
from surg_recording.datasets import ExportOptions
from surg_sim.envs.cell_session import CellSession, Command, Tick
from surg_sim.envs.episode_runner import run_episode
from surg_sim.envs.recorded_episode import RecordedSession
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.tasks.scripted_sender import Action, Expert, Observation
from surg_sim.tasks.task import State, Task, Verdict

Array = NDArray[np.float64]
ARM = "PSM1"
CELL = paths.ROOT / "cells/sim_ur5e_wrist"
SECONDS = 6.0
OPTIONS = ExportOptions(executor="serial", splits={"train": 1.0})


class Free(Task):
    """Nothing to do for a while."""

    name, title, time_limit = "free", "Free motion", SECONDS

    def bind(self, world: Any) -> None:
        """No objects."""

    def reset(self, rng: np.random.Generator) -> None:
        """See ``Task``."""
        super().reset(rng)

    def state(self) -> State:
        """The time."""
        return {"time": self.time}

    def verdict(self) -> Verdict:
        """Ends with the time."""
        return self.late("free") or Verdict(phase="free")


class Turning(Expert):
    """Moves the tip by some centimetres and turns it about every axis, from where it is."""

    arms = (ARM,)

    def __init__(self, session: CellSession, seed: int) -> None:
        draws = np.random.default_rng(seed)
        self._session, self._begun = session, 0
        self._frequency, self._phase = draws.uniform(0.2, 0.4, 6), draws.uniform(0.0, 6.3, 6)
        self._bring_up = BringUp()
        self._bring_up.start(0)

    def act(self, observation: Observation) -> Action:
        """A pose at every grid time."""
        view, t = observation.arms[ARM], observation.tick * TICK
        if not view.ready:
            return Action(arms={ARM: self._bring_up.tick(view, observation.tick * TICK_NS)})
        assert view.wrist is not None
        if not self._begun:
            self._begun = observation.tick
            X_BR = np.asarray(self._session.controllers[ARM].X_BR)
            self._p = X_BR[:3, :3].T @ (view.p_BSet - X_BR[:3, 3])
            self._R = surg_core.quaternion_xyzw_to_matrix(view.wrist.q_RSet)
        t -= self._begun * TICK
        grow = 0.5 - 0.5 * np.cos(np.pi * min(t / 2.0, 1.0))
        wave = np.sin(2 * np.pi * self._frequency * t + self._phase) - np.sin(self._phase)
        x = grow * np.repeat([0.008, 0.3], 3) * wave
        R_RTip = Rotation.from_rotvec(x[3:]).as_matrix() @ self._R
        pose = TipPose(self._p + x[:3], 0.0, R_RTip)
        jaw = 0.3 + 0.2 * float(np.sin(t))
        return Action(arms={ARM: ArmCommands(servo_cp=pose, jaw=jaw)})


@dataclass
class Truth:
    """By stamp [ns]: the simulator's tool frame in the rcm frame, and what the arm measured."""

    tip: dict[int, Array] = field(default_factory=dict)
    measured_js: dict[int, Array] = field(default_factory=dict)


class WatchedSession(RecordedSession):
    """Keeps the truth of every tick."""

    truth: Truth
    R_TipTool: Array | None = None
    instead: dict[int, surg_core.MotionCommand] | None = None
    """Poses by stamp [ns], obeyed in the place of the sender's."""

    def tick(
        self,
        commands: Mapping[str, Sequence[Command]] | None = None,
        assistant: AssistantCommand | None = None,
    ) -> Tick:
        """See ``CellSession.tick``."""
        stamp, X_WTip = self.world.tick * TICK_NS, self._tip_body()
        if self.instead is not None:
            pose = surg_core.Motion.SERVO_CP
            kept = [c for c in (commands or {}).get(ARM, ()) if getattr(c, "motion", None) != pose]
            commands = {ARM: kept + [self.instead[t] for t in (stamp,) if t in self.instead]}
        tick = super().tick(commands, assistant)
        out, controller = tick.outputs[ARM], self.controllers[ARM]
        assert out.wrist is not None
        if out.homed:
            X_WR = np.asarray(self.cell.arms[ARM].X_WB_stated) @ np.asarray(controller.X_BR)
            X_RTip = np.linalg.inv(X_WR) @ X_WTip
            if self.R_TipTool is None:  # the tool frame is the rcm frame at home
                self.R_TipTool = X_RTip[:3, :3].T.copy()
            X_RTip[:3, :3] = X_RTip[:3, :3] @ self.R_TipTool
            self.truth.tip[stamp] = X_RTip
            self.truth.measured_js[stamp] = np.array([*out.virtual_q, *out.wrist.q])
        return tick

    def _tip_body(self) -> Array:
        link = self.cell.arms[ARM].instrument.tip_link
        body = self.world.model.body(f"{ARM}_{link}").id
        X_WTip = np.eye(4)
        X_WTip[:3, :3] = self.world.data.xmat[body].reshape(3, 3)
        X_WTip[:3, 3] = self.world.data.xpos[body]
        return X_WTip


def record(folder: Path, seed: int = 3) -> Truth:
    """Record an episode; every pose is accepted."""
    session = WatchedSession(CELL, Free(), seed=seed)
    session.truth = Truth()
    report = session.record(folder, seed, {"expert": Turning(session, seed)})
    assert "time limit" in report.reason, report.reason
    return session.truth


def replay(commands: dict[int, surg_core.MotionCommand], seed: int = 3) -> Truth:
    """The same episode with other poses, by stamp [ns]."""
    session = WatchedSession(CELL, Free(), seed=seed)
    session.truth, session.instead = Truth(), commands
    run_episode(session, seed, {"expert": Turning(session, seed)})
    return session.truth


def tip_pose(row: Array) -> TipPose:
    """The pose of an absolute action x, y, z, qx, qy, qz, qw, jaw."""
    return TipPose(row[:3], 0.0, Rotation.from_quat(row[3:7]).as_matrix())


def recorded_at_the_end(folder: Path, *columns: str) -> list[float]:
    """The last control cycle."""
    with (folder / f"cycle_{ARM}.csv").open(newline="") as file:
        row = list(csv.DictReader(file))[-1]
    return [float(row[name]) for name in columns]


def rcm_frame(folder: Path) -> Array:
    """Orientation (3, 3) of the rcm frame in the base, as recorded."""
    q = recorded_at_the_end(folder, *(f"q_br_{axis}" for axis in "xyzw"))
    return np.asarray(Rotation.from_quat(q).as_matrix())
