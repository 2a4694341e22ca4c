#!/usr/bin/env python3
"""Step 1: the 500 Hz controller in a loop of your own, without ROS and without a simulator.

You learn: how to load a cell, enable an arm, stream tip positions and read what each cycle decided.

    ./surg dev shell -c "python3 examples/01_core.py"

Without the workspace: ``pip install ./src/surg_core``, then ``python3 examples/01_core.py``.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

try:
    import surg_core
    from surg_core import Motion, MotionCommand, StateCommand
except ModuleNotFoundError as missing:
    raise SystemExit(
        f"{missing}: pip install ./src/surg_core, or ./surg dev shell -c 'python3 {__file__}'"
    ) from None

CELL = Path(__file__).resolve().parents[1] / "cells" / "sim_ur5e"
DT = 0.002  # [s] control period


def main() -> None:
    """Drive the tip of an ideal UR5e round a circle inside the patient."""
    arm = surg_core.load_cell(CELL).arms["PSM1"]
    controller = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
    controller.set_rcm(arm.trocar.p_BRcm)
    q, qd = np.array(arm.robot.home), np.zeros(arm.chain.dof)
    controller.step(q, qd)  # the controller must have seen the joints before it can be enabled
    controller.request(StateCommand.ENABLE)
    controller.request(StateCommand.HOME)

    rcm_error, tip = [], []
    for k in range(3000):
        t = k * DT
        p = [0.01 * math.sin(t) ** 2, 0.02 * math.sin(t), 0.12]  # rcm frame: z into the patient [m]
        target = MotionCommand(Motion.SERVO_CP, source=1, p=p, rotation=[0, 0, 0, 1])
        out = controller.step(q, qd, [target])
        if out.refused:
            raise SystemExit(surg_core.sentence(out.verdicts[0].reason))
        q, qd = q + DT * out.qd_command, out.qd_command  # the ideal arm: it does what it is told
        rcm_error.append(out.rcm_error)
        tip.append(out.p_BTip)

    path = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()
    print(f"{len(tip)} cycles, tip path {1e3 * path:.1f} mm, depth {1e3 * out.depth:.1f} mm")
    print(f"RCM deviation at most {1e6 * max(rcm_error):.3f} um")


if __name__ == "__main__":
    main()
