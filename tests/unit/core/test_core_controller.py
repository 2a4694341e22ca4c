"""The controller through its binding: a closed loop with an ideal arm, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import surg_core
from surg_core import Motion, MotionCommand, Reason, State, StateCommand

CELLS = Path(__file__).resolve().parents[3] / "cells"


class Loop:
    """A controller and an arm that obeys at once."""

    def __init__(self, cell: str, **options: object) -> None:
        """Loads the cell and stands at its home."""
        self.arm = surg_core.load_cell(CELLS / cell).arms["PSM1"]
        arm = self.arm
        self.controller = surg_core.Controller(
            arm.chain,
            arm.robot,
            arm.limits,
            arm.instrument,
            arm.tool,
            **options,  # type: ignore[arg-type]
        )
        self.q = np.array(arm.robot.home)
        self.qd = np.zeros(arm.chain.dof)

    def step(self, *commands: MotionCommand) -> surg_core.Outputs:
        """One cycle; the arm moves as commanded."""
        out = self.controller.step(self.q, self.qd, commands)
        self.qd = out.qd_command
        self.q = self.q + self.qd * self.controller.dt
        return out

    def start(self) -> None:
        """Teaches the trocar, enables and homes."""
        assert self.controller.set_rcm(self.arm.trocar.p_BRcm) == Reason.NONE
        self.step()
        assert self.controller.request(StateCommand.ENABLE) == Reason.NONE
        assert self.controller.request(StateCommand.HOME) == Reason.NONE
        self.step()


@pytest.mark.parametrize("cell", ["sim_ur5e", "sim_panda"])
def test_a_stream_is_followed_and_the_trocar_kept(cell: str) -> None:
    loop = Loop(cell)
    loop.start()
    X_BR = loop.controller.X_BR
    np.testing.assert_allclose(
        X_BR, surg_core.rcm_frame(loop.step().s_B, loop.arm.trocar.p_BRcm), atol=1e-6
    )
    worst_pivot, worst_tip, accepted = 0.0, 0.0, 0
    delay = loop.arm.robot.tuning.stream_delay

    def hand(t: float) -> np.ndarray:
        grow = min(t, 1.0)
        return np.array([0.01 * grow * math.sin(2 * t), 0.01 * grow * math.sin(3 * t), 0.12])

    for k in range(1500):
        t = 0.002 * k
        p = hand(t)
        out = loop.step(MotionCommand(Motion.SERVO_CP, source=7, p=p, rotation=[0, 0, 0, 1]))
        assert out.verdicts[0].reason == Reason.NONE, surg_core.sentence(out.verdicts[0].reason)
        accepted += 1
        if k > 500:
            worst_pivot = max(worst_pivot, out.rcm_error)
            tip = X_BR[:3, :3].T @ (out.p_BTip - X_BR[:3, 3])
            late = (float(np.linalg.norm(tip - hand(t - lag))) for lag in np.linspace(0, delay, 26))
            worst_tip = max(worst_tip, min(late))
    assert out.state == State.ENABLED
    assert out.homed
    assert out.source == 7
    assert out.motion == Motion.SERVO_CP
    assert out.accepted == accepted
    assert worst_pivot < 5e-5  # the path has a kink at 1 s, which no link follows at once
    assert worst_tip < 1e-3
    assert out.qd_command.shape == (loop.arm.chain.dof,)
    assert out.X_BF.shape == (4, 4)
    np.testing.assert_allclose(
        loop.arm.chain.jacobian(loop.q) @ out.qd_command, out.twist_command, atol=1e-3
    )


def test_outputs_are_copies() -> None:
    loop = Loop("sim_ur5e")
    loop.start()
    first = loop.step()
    before = first.p_BTip.copy()
    for _ in range(10):
        loop.step(MotionCommand(Motion.SERVO_CV, p=[0.02, 0, 0]))
    np.testing.assert_array_equal(first.p_BTip, before)
    with pytest.raises(ValueError, match="read-only"):
        first.p_BTip[:] = 0


def test_what_is_refused_says_why() -> None:
    loop = Loop("sim_ur5e")
    controller = loop.controller
    assert not controller.rcm_set
    out = loop.step(MotionCommand(Motion.SERVO_CP, source=3, p=[0, 0, 0.12]))
    verdict = out.verdicts[0]
    assert (verdict.reason, verdict.source, verdict.motion) == (
        Reason.NOT_ENABLED,
        3,
        Motion.SERVO_CP,
    )
    assert out.refused == 1
    loop.start()
    assert controller.set_rcm([0, 0, 0]) == Reason.RCM_WHILE_ENABLED
    out = loop.step(MotionCommand(Motion.SERVO_CP, p=[0, 0, 0.5], rotation=[0, 0, 0, 1]))
    assert out.verdicts[0].reason == Reason.OUTSIDE_WORKSPACE
    out = controller.step(np.full(6, math.nan), loop.qd)
    assert out.state == State.FAULT
    assert out.reason == Reason.STATE_NOT_FINITE
    assert not out.qd_command.any()


def test_the_law_of_the_paper_and_the_gain_can_be_chosen() -> None:
    paper = Loop("sim_ur5e", law=surg_core.Law.PAPER)
    open_loop = Loop("sim_ur5e", feedback_gain=0.0, dt=0.004, law=surg_core.Law.VELOCITY)
    assert open_loop.controller.dt == 0.004
    for loop in (paper, open_loop):
        loop.start()
        for _ in range(20):
            out = loop.step(MotionCommand(Motion.SERVO_CV, p=[0.05, 0, 0]))
        assert out.twist_command.any()


def test_wrong_shapes_raise_before_anything_happens() -> None:
    loop = Loop("sim_ur5e")
    with pytest.raises(ValueError, match=r"q: shape \(6,\) is needed, not \(7,\)"):
        loop.controller.step(np.zeros(7), np.zeros(6))
    with pytest.raises(ValueError, match=r"qd: shape \(6,\)"):
        loop.controller.step(np.zeros(6), np.zeros(1))
    with pytest.raises(ValueError, match=r"at most 64 per cycle, not 65"):
        loop.controller.step(np.zeros(6), np.zeros(6), [MotionCommand(Motion.HOLD)] * 65)
    with pytest.raises(ValueError, match=r"p: shape \(3,\)"):
        MotionCommand(Motion.SERVO_CP, p=[0, 0])
    with pytest.raises(ValueError, match=r"rotation: shape \(4,\)"):
        MotionCommand(Motion.SERVO_CP, rotation=np.eye(3))
    for rotation in ([0.0] * 4, [0.0, 0.0, 0.0, 0.99], [0.0, 0.0, 0.0, 1e308]):
        with pytest.raises(ValueError, match="unit quaternion"):
            MotionCommand(Motion.MOVE_CP, p=[0, 0, 0.12], rotation=rotation)
    with pytest.raises(TypeError):
        MotionCommand("servo_cp")  # type: ignore[arg-type]


def test_a_command_shows_what_it_holds() -> None:
    command = MotionCommand(
        Motion.SERVO_JP, source=2, joints=[1, 2, 3, 4], rotation=[0.1, 0.5, 0.7, 0.5], jaw=0.5
    )
    np.testing.assert_array_equal(command.joints, [1, 2, 3, 4])
    np.testing.assert_array_equal(command.rotation, [0.1, 0.5, 0.7, 0.5])
    assert (command.source, command.jaw, int(command.motion)) == (2, 0.5, 2)
