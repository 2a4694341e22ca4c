#!/usr/bin/env python3
"""The controller of the real arm, in a loop of your own: no ROS, no simulator.

Run it after ``pip install ./src/surg_core`` (or in the workspace): it drives an ideal UR5e round a
circle, replays the run in one call, and looks at how well the pivot was kept.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import surg_core
from surg_core import Motion, MotionCommand, Reason, StateCommand

CELL = Path(__file__).resolve().parents[1] / "cells" / "sim_ur5e"
SECONDS = 6.0


def main() -> None:
    """Drive, replay, analyse."""
    arm = surg_core.load_cell(CELL).arms["PSM1"]

    def controller() -> surg_core.Controller:
        made = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
        made.set_rcm(arm.trocar.p_BRcm)
        made.step(arm.robot.home, np.zeros(arm.chain.dof))
        for word in (StateCommand.ENABLE, StateCommand.HOME):
            answer = made.request(word)
            if answer != Reason.NONE:
                raise SystemExit(surg_core.sentence(answer))
        return made

    # 1. A closed loop: the arm does what it is told at once.
    mine, dt = controller(), 0.002
    q, qd = np.array(arm.robot.home), np.zeros(arm.chain.dof)
    joints, rates, commands = [], [], []
    for k in range(round(SECONDS / dt)):
        t = k * dt
        p = [0.01 * math.sin(t) ** 2, 0.02 * math.sin(t), 0.12]  # in the rcm frame [m]
        command = MotionCommand(Motion.SERVO_CP, source=1, p=p, rotation=[0, 0, 0, 1])
        out = mine.step(q, qd, [command])
        if out.refused:
            raise SystemExit(surg_core.sentence(out.verdicts[0].reason))
        joints.append(q)
        rates.append(qd)
        commands.append((k, command))
        qd = out.qd_command
        q = q + dt * qd

    # 2. The same run as one call over arrays: for data sets, and off the GIL.
    run = controller().run(joints, rates, commands)
    assert np.array_equal(run.qd_command[-1], out.qd_command)

    # 3. What a calibration error of 1 mm would have done, on all poses at once.
    X_BF = arm.chain.forward_batch(joints)
    p_FTip = np.add(arm.tool.p_FTip, [0.001, 0.0, 0.0])
    off = surg_core.shaft_states(X_BF, arm.tool.s_F, p_FTip, arm.trocar.p_BRcm)
    path = np.linalg.norm(np.diff(run.p_BTip, axis=0), axis=1).sum()
    print(f"{len(run)} cycles, tip path {1e3 * path:.1f} mm, depth {run.depth.min():.3f} to")
    print(f"{run.depth.max():.3f} m, RCM deviation at most {1e6 * run.rcm_error.max():.3f} um")
    print(f"with a tool 1 mm wrong: {1e3 * off.deviation.max():.3f} mm")


if __name__ == "__main__":
    main()
