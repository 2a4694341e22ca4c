"""A calibration bench in the simulator, and a run that tells how well a calibration keeps a pivot.

The hands know the true tool (from the URDF) and are not steady: the tip has play in its divot, the
shaft in its guide. The recording sees the joint states of the simulated arm only, with an encoder's
noise and quantisation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core import Motion, MotionCommand, Reason, StateCommand
from surg_sim.arm import TICK, ArmCommand
from surg_sim.trocar import TrocarParameters, shaft_in_flange
from surg_sim.world import World

Array = NDArray[np.float64]

ENCODER_SIGMA = 2e-5  # [rad]
ENCODER_STEP = 1e-5  # [rad]
DIVOT_PLAY = 5e-5  # [m] per axis, one sigma
GUIDE_PLAY = 1e-3  # [rad] per axis, one sigma
TROCAR_PLAY = 1e-4  # [m] per axis, one sigma
NO_WALL = TrocarParameters(stiffness=0.1, friction=0.0)
"""A wall that is not felt: the instrument is on a bench, not in a patient."""


def turn(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (3,) by an angle [rad]."""
    return surg_core.axis_angle_to_matrix(np.asarray(axis, dtype=float), angle)


def across(s: Array, rng: np.random.Generator) -> Array:
    """A random unit vector (3,) perpendicular to s (3,)."""
    v = np.cross(s, rng.normal(size=3))
    return np.asarray(v / np.linalg.norm(v))


class Bench:
    """One arm of a cell on the bench.

    Args:
        cell: A loaded cell.
        seed: Of hands and encoders.
    """

    def __init__(self, cell: surg_core.Cell, seed: int) -> None:
        self.cell, self.arm = cell, cell.arms["PSM1"]
        self.rng = np.random.default_rng(seed)
        self.p_FTip, self.s_F = shaft_in_flange(self.arm)
        self.home = np.array(self.arm.robot.home)
        self.X_home = self.arm.chain.forward(self.home)
        self.s_home = self.X_home[:3, :3] @ self.s_F
        self.tip_home = self.X_home[:3, :3] @ self.p_FTip + self.X_home[:3, 3]

    def record(self, path: Path, motions: tuple[str, ...], count: int = 12) -> None:
        """Perform motions by hand and write the recording.

        Args:
            path: CSV file.
            motions: Of ``surg_core.calibration.MOTIONS``, not ``second``.
            count: Poses of each.
        """
        lines = [",".join(["motion", *self.arm.robot.joint_names])]
        for motion in motions:
            wall = None if motion == "trocar" else NO_WALL
            world = World(self.cell, trocar=wall)
            for q in self._poses(motion, count):
                measured = self._measure(world, q)
                lines.append(",".join([motion, *(f"{value:.9f}" for value in measured)]))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _poses(self, motion: str, count: int) -> Iterator[Array]:
        """Joint positions (n,) of the hand-guided poses; what the arm cannot reach is not tried."""
        found = 0
        for _ in range(20 * count):
            q = self._inverse(self._pose(motion))
            if q is not None:
                found += 1
                yield q
            if found == count:
                return
        raise RuntimeError(f"{motion}: only {found} of {count} poses are within reach")

    def _pose(self, motion: str) -> Array:
        """A flange pose (4, 4) that puts the true instrument where the hands want it."""
        rng, R = self.rng, self.X_home[:3, :3]
        if motion == "roll":
            R = turn(self.s_home, rng.uniform(-1.2, 1.2)) @ R
            play = rng.normal(scale=GUIDE_PLAY, size=3)
            R = turn(play / np.linalg.norm(play), float(np.linalg.norm(play))) @ R
            tip = self.tip_home + rng.uniform(-0.02, 0.02) * self.s_home
        else:
            tilt = turn(across(self.s_home, rng), rng.uniform(0.15, 0.5))
            R = tilt @ turn(self.s_home, rng.uniform(-1.0, 1.0)) @ R
            if motion == "tip":
                tip = self.tip_home + rng.normal(scale=DIVOT_PLAY, size=3)
            else:
                s = R @ self.s_F
                play = rng.normal(scale=TROCAR_PLAY, size=3)
                tip = self.arm.trocar.p_BRcm + rng.uniform(0.06, 0.16) * s + play
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, tip - R @ self.p_FTip
        return X

    def _inverse(self, X: Array) -> Array | None:
        """Joints (n,) for a flange pose, from home by damped Newton steps; None: out of reach."""
        q, chain = self.home.copy(), self.arm.chain
        for _ in range(100):
            present = chain.forward(q)
            R = X[:3, :3] @ present[:3, :3].T
            angle = math.acos(float(np.clip((np.trace(R) - 1) / 2, -1, 1)))
            w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            scale = 0.5 if angle < 1e-6 else angle / (2 * math.sin(angle))
            error = np.concatenate([X[:3, 3] - present[:3, 3], scale * w])
            if np.linalg.norm(error) < 1e-12:
                low, high = self.arm.robot.position_min, self.arm.robot.position_max
                return q if np.all((q > low) & (q < high)) else None
            J = chain.jacobian(q)
            step = J.T @ np.linalg.solve(J @ J.T + 1e-10 * np.eye(6), error)
            q = q + step * min(1.0, 0.3 / float(np.max(np.abs(step))))
        return None

    def _measure(self, world: World, goal: Array) -> Array:
        """Guides the simulated arm there; what its encoders say at standstill (n,)."""
        for _ in range(3000):
            state = world.state("PSM1")
            if np.max(np.abs(goal - state.q)) < 2e-5 and np.max(np.abs(state.qd)) < 1e-4:
                break
            velocity = np.clip(12.0 * (goal - state.q), -0.6, 0.6)
            world.step({"PSM1": ArmCommand(velocity=velocity)})
        q = world.state("PSM1").q + self.rng.normal(scale=ENCODER_SIGMA, size=len(goal))
        return np.asarray(np.round(q / ENCODER_STEP) * ENCODER_STEP)


def wrong_tool(arm: surg_core.Arm, rng: np.random.Generator) -> surg_core.ToolCalibration:
    """The true tool with its tip 1 mm aside and its axis 0.5 deg off.

    The direction is random; at the trocar the two add up.
    """
    p_FTip, s_F = shaft_in_flange(arm)
    aside = across(s_F, rng)
    leaning = turn(np.cross(s_F, -aside), math.radians(0.5)) @ s_F
    return tool_of(leaning, p_FTip + 0.001 * aside)


def tool_of(s_F: Array, p_FTip: Array) -> surg_core.ToolCalibration:
    """A tool calibration (3,), (3,) as a file would hold it."""
    return surg_core.parse_tool(
        surg_core.Document(
            "tool.yaml",
            {
                "format": "surg_tool/1",
                "shaft_axis": [float(value) for value in s_F],
                "tip": [float(value) for value in p_FTip],
                "residual": 0.0,
                "n": 1,
                "condition": 1.0,
                "date": "2026-11-21",
            },
        )
    )


@dataclass(frozen=True)
class Deviation:
    """RCM deviations of a run [m].

    Attributes:
        kinematic: (n,) what the controller computes with its own calibration.
        true: (n,) distance of the undisturbed trocar point to the simulated shaft.
    """

    kinematic: Array
    true: Array


def run(
    cell: surg_core.Cell, tool: surg_core.ToolCalibration, p_BRcm: Array, seconds: float
) -> Deviation:
    """A Lissajous motion of the tip in the simulator under a controller with this calibration.

    Args:
        cell: The cell; its trocar is where the simulated wall is.
        tool: What the controller believes the tool to be.
        p_BRcm: (3,) what it believes the trocar point to be [m].
        seconds: Of motion, after 2 s of growing amplitude.
    """
    arm, world = cell.arms["PSM1"], World(cell)
    controller = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, tool)
    assert controller.set_rcm(p_BRcm) == Reason.NONE
    state = world.state("PSM1")
    controller.step(state.q, state.qd)
    for word in (StateCommand.ENABLE, StateCommand.HOME):
        answer = controller.request(word)
        assert answer == Reason.NONE, surg_core.sentence(answer)
    start = controller.step(state.q, state.qd).virtual_q[2]
    kinematic, true = [], []
    for k in range(round((seconds + 2.0) / TICK)):
        t = k * TICK
        grow = min(t / 2.0, 1.0)
        p = np.array(
            [
                0.035 * grow * math.sin(2 * math.pi * 0.2 * t),
                0.035 * grow * math.sin(2 * math.pi * 0.15 * t),
                start + 0.025 * grow * math.sin(2 * math.pi * 0.1 * t),
            ]
        )
        roll = 1.2 * grow * math.sin(2 * math.pi * 0.12 * t)
        turned = [0.0, 0.0, math.sin(roll / 2), math.cos(roll / 2)]
        state = world.state("PSM1")
        command = MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=turned)
        out = controller.step(state.q, state.qd, [command], jaw=state.jaw)
        assert out.refused == 0, surg_core.sentence(out.verdicts[0].reason)
        world.step({"PSM1": ArmCommand(velocity=out.qd_command)})
        if grow >= 1.0:
            kinematic.append(out.rcm_error)
            true.append(world.truth("PSM1").deviation)
    return Deviation(np.array(kinematic), np.array(true))


def taught_at_home(arm: surg_core.Arm, tool: surg_core.ToolCalibration) -> Array:
    """What teaching one point gives: on the believed shaft, beside the true trocar; (3,) [m]."""
    X = arm.chain.forward(np.array(arm.robot.home))
    state = surg_core.shaft_state(X, tool.s_F, tool.p_FTip, arm.trocar.p_BRcm)
    return np.array(state.p_BNear)
