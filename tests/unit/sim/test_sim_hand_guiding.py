"""An arm that is off its trocar is led home by hand."""

from __future__ import annotations

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_sim.physics import hand_guiding
from surg_sim.physics.hand_guiding import guided_home
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

CELL = paths.ROOT / "cells" / "sim_ur5e"


def away(world: World) -> float:
    """From the trocar to the shaft [mm]."""
    truth = world.truth("PSM1")
    d = truth.trocar - truth.shaft_point
    return 1e3 * float(np.linalg.norm(d - (d @ truth.shaft_axis) * truth.shaft_axis))


def test_a_torn_arm_comes_home_and_is_let_go() -> None:
    cell = surg_core.load_cell(str(CELL))
    world = World(cell)
    home = np.asarray(cell.arms["PSM1"].robot.home)
    rng = np.random.default_rng(3)
    for _ in range(3):
        world.reset()
        push = ArmCommand(velocity=0.08 * rng.choice([-1.0, 1.0], len(home)))
        for _ in range(100):  # 16 mrad in each joint: some 10 mm at the trocar
            world.step({"PSM1": push})
        off = away(world)
        ticks, fastest = 0, 0.0
        while led := guided_home(home, world.state("PSM1").q, ArmCommand(np.zeros(len(home)))):
            assert led.velocity is not None
            fastest = max(fastest, float(np.abs(led.velocity).max()))
            world.step({"PSM1": led})
            ticks += 1
            assert ticks < 5000, "it never comes home"
        print(f"{off:.1f} mm off; home after {2 * ticks} ms, {away(world):.3f} mm")
        assert off > 2.0, "it was never torn"
        assert away(world) < 1.0 and fastest <= hand_guiding.SPEED + 1e-12


@pytest.mark.parametrize(
    "command",
    [
        ArmCommand(velocity=np.array([0.0, 0.01])),
        ArmCommand(twist=np.array([0.0, 0.0, 0.002, 0.0, 0.0, 0.0])),
        ArmCommand(velocity=np.array([0.0, np.nan])),
    ],
)
def test_a_controller_that_moves_the_arm_comes_first(command: ArmCommand) -> None:
    home, q = np.zeros(2), np.array([0.1, 0.1])
    assert guided_home(home, q, ArmCommand(jaw=0.3)) is not None
    assert guided_home(home, q, command) is None


def test_the_jaw_is_its_own() -> None:
    led = guided_home(np.zeros(2), np.array([0.1, -0.2]), ArmCommand(jaw=0.3))
    assert led is not None and led.jaw == 0.3
    assert led.velocity == pytest.approx([-0.1, 0.2])
