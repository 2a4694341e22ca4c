#!/usr/bin/env python3
"""Step 2: kinematics and limits: what the controller computes, refuses and slows down.

You learn: forward kinematics and Jacobian of a chain, what a calibration error does to the pivot,
why a command is refused, and how a limit slows a motion without leaving the pivot.

    ./surg dev shell -c "python3 examples/02_limits.py"
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import surg_core
from surg_core import Motion, MotionCommand, StateCommand

CELL = Path(__file__).resolve().parents[1] / "cells" / "sim_ur5e"
DT = 0.002  # [s]


def ready(arm: surg_core.CellArm) -> surg_core.Controller:
    """A controller that has seen the arm at home and is enabled."""
    controller = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
    controller.set_rcm(arm.trocar.p_BRcm)
    controller.step(arm.robot.home, np.zeros(arm.chain.dof))
    controller.request(StateCommand.ENABLE)
    controller.request(StateCommand.HOME)
    return controller


def kinematics(arm: surg_core.CellArm) -> None:
    """Poses and Jacobians of single postures and of whole arrays."""
    X_BF = arm.chain.forward(arm.robot.home)  # (4, 4) flange in the robot base
    J = arm.chain.jacobian(arm.robot.home)  # (6, n): linear rows, then angular, in the base
    print(f"flange at {np.round(X_BF[:3, 3], 3)} m, |det J| = {abs(np.linalg.det(J)):.3f}")

    postures = arm.robot.home + np.random.default_rng(0).normal(0.0, 0.02, (1000, arm.chain.dof))
    poses = arm.chain.forward_batch(postures)  # (1000, 4, 4), computed without the GIL
    wrong_tip = np.add(arm.tool.p_FTip, [0.001, 0.0, 0.0])
    exact, wrong = (
        surg_core.shaft_states(poses, arm.tool.s_F, p_FTip, arm.trocar.p_BRcm).deviation
        for p_FTip in (arm.tool.p_FTip, wrong_tip)
    )
    print(
        f"1 mm of tool error changes the deviation by up to {1e3 * abs(wrong - exact).max():.2f} mm"
    )


def refusal(arm: surg_core.CellArm) -> None:
    """A target outside the workspace is refused with a reason; it is never clipped."""
    outside = [0.0, 0.0, arm.limits.depth_max + 0.01]
    command = MotionCommand(Motion.MOVE_CP, source=1, p=outside, rotation=[0, 0, 0, 1])
    out = ready(arm).step(arm.robot.home, np.zeros(arm.chain.dof), [command])
    print(f"depth {outside[2]:.2f} m: {surg_core.sentence(out.verdicts[0].reason)}")


def slow_down(arm: surg_core.CellArm) -> None:
    """A fast move: the limits scale it in time; joints slow down together, so the pivot stays."""
    controller, lag = ready(arm), arm.robot.tuning.link_lag
    q, qd = np.array(arm.robot.home), np.zeros(arm.chain.dof)
    move = MotionCommand(Motion.MOVE_CP, source=1, p=[0.05, 0.08, 0.10], rotation=[0, 0, 0, 1])
    scale, rcm_error, fastest, limited_by = 1.0, 0.0, 0.0, set[str]()
    out = controller.step(q, qd, [move])
    cycles = 1
    while out.busy:
        qd = qd + (out.qd_command - qd) * DT / lag  # an arm with the lag that its YAML states
        q = q + DT * qd
        out = controller.step(q, qd)
        cycles += 1
        scale, rcm_error = min(scale, out.scale), max(rcm_error, out.rcm_error)
        fastest = max(fastest, float(np.abs(out.qd_command).max()))
        limited_by |= {out.limited_by} - {""}
    print(f"move in {cycles * DT:.2f} s, slowed down to {scale:.2f} of its pace by limits")
    print(f"limited by {', '.join(sorted(limited_by))}; fastest joint {fastest:.2f} rad/s")
    print(f"RCM deviation at most {1e6 * rcm_error:.0f} um")


def main() -> None:
    """All three."""
    arm = surg_core.load_cell(CELL).arms["PSM1"]
    kinematics(arm)
    refusal(arm)
    slow_down(arm)


if __name__ == "__main__":
    main()
