"""What every law is given, written for the C++ program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from surg_core import rcm_frame
from surg_core.config import Arm, load_cell

FloatArray = npt.NDArray[np.float64]

PERIOD = 0.002  # control period [s]
AMPLITUDE = (0.035, 0.035, 0.025)  # [m], in the axes of the trocar frame
FREQUENCY = (0.2, 0.15, 0.1)  # [Hz]
RUN_IN = 1.0  # [s] from rest to the full motion
BINDING = 0.1  # share of the joints' limits that binds this motion
TAIL = 250  # samples behind the last cycle, for those who look ahead (kTail in src/main.cpp)


def load_arm(cell: Path) -> Arm:
    """The first arm of a cell."""
    return next(iter(load_cell(cell / "cell.yaml").arms.values()))


def lissajous(arm: Arm, seconds: float) -> FloatArray:
    """Tip in the robot base at each tick: a Lissajous figure about the tip at home.

    Args:
        arm: The arm, for the tip at home.
        seconds: Length [s].

    Returns:
        Positions ``(n + 1 + TAIL, 3)`` [m]; the motion begins at rest at home and blends in.
    """
    t = np.arange(round(seconds / PERIOD) + 1 + TAIL) * PERIOD
    s = np.clip(t / RUN_IN, 0, 1)
    # Phase of rest: the clock itself is started smoothly, velocity and acceleration from zero.
    clock = np.where(t < RUN_IN, RUN_IN * (s**3 - 0.5 * s**4), t - 0.5 * RUN_IN)
    offset = np.stack(
        [a * np.sin(2 * np.pi * f * clock) for a, f in zip(AMPLITUDE, FREQUENCY, strict=True)],
        axis=1,
    )
    X_BF = arm.chain.forward(arm.robot.home)
    X_BR = np.asarray(rcm_frame(X_BF[:3, :3] @ arm.tool.s_F, arm.trocar.p_BRcm))
    home = X_BF[:3, :3] @ arm.tool.p_FTip + X_BF[:3, 3]
    return np.asarray(home + offset @ X_BR[:3, :3].T)


def write_arm(arm: Arm, file: Path, share: float) -> None:
    """The arm as words and numbers, in the order that ``src/arm.cpp`` reads."""

    def numbers(values: object) -> str:
        return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values)))

    robot = arm.robot
    lines = [f"name {robot.name}", f"joints {arm.chain.dof}"]
    for joint in arm.chain.joints:
        lines += [f"X_PJ {numbers(joint.X_PJ[:3])}", f"axis {numbers(joint.axis)}"]
    lines += [
        f"X_LF {numbers(arm.chain.X_LF[:3])}",
        f"home {numbers(robot.home)}",
        f"position_min {numbers(robot.position_min)}",
        f"position_max {numbers(robot.position_max)}",
        f"velocity {numbers(share * robot.velocity)}",
        f"acceleration {numbers(share * robot.acceleration)}",
        f"flange_velocity {arm.limits.flange_velocity!r}",
        f"shaft_axis {numbers(arm.tool.s_F)}",
        f"tip {numbers(arm.tool.p_FTip)}",
        f"trocar {numbers(arm.trocar.p_BRcm)}",
    ]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write(arm: Arm, seconds: float, folder: Path, share: float = 1.0) -> None:
    """Both files of one arm: `arm.txt` and `tip.path` (raw doubles).

    Args:
        arm: The arm.
        seconds: Length of the motion [s].
        folder: Where they go.
        share: Of the arm's joint velocities and accelerations.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_arm(arm, folder / "arm.txt", share)
    lissajous(arm, seconds).tofile(folder / "tip.path")
