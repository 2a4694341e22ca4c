"""What a calibration does to the pivot: a wrong one, and a simulated run that measures it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core import Motion, MotionCommand, Reason, StateCommand, _core, axis_angle_to_matrix
from surg_core.contract import TICK
from surg_sim.physics.calibration_bench import across
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.trocar import shaft_in_flange
from surg_sim.physics.world import World

Array = NDArray[np.float64]


def wrong_tool(arm: surg_core.Arm, rng: np.random.Generator) -> surg_core.ToolCalibration:
    """The true tool with its tip 1 mm aside and its axis 0.5 deg off.

    The direction is random; at the trocar the two add up.
    """
    p_FTip, s_F = shaft_in_flange(arm)
    aside = across(s_F, rng)
    leaning = axis_angle_to_matrix(np.cross(s_F, -aside), math.radians(0.5)) @ s_F
    return tool_of(leaning, p_FTip + 0.001 * aside)


def tool_of(s_F: Array, p_FTip: Array) -> surg_core.ToolCalibration:
    """A tool calibration (3,), (3,) as a file would hold it."""
    return _core.parse_tool(
        _core.Document(
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
