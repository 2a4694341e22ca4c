"""The estimate beside the simulator's truth: a moving arm, random loads, a breathing trocar."""

from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.force.loaded_arm import TICK, LoadedArm, Row, calibrated, inside, rms, sensing_cell
from surg_core.force.load_solver import LoadFit


@pytest.fixture(scope="module")
def cell() -> surg_core.Cell:
    return sensing_cell()


@pytest.fixture(scope="module")
def fit(cell: surg_core.Cell, tmp_path_factory: pytest.TempPathFactory) -> LoadFit:
    folder: Path = tmp_path_factory.mktemp("bench")
    return calibrated(cell, folder)


def played(cell: surg_core.Cell, fit: LoadFit, depth: float, seconds: float) -> list[Row]:
    arm = LoadedArm(cell, fit, seed=3, depth=depth)
    arm.begin()
    rows = [arm.tick(k * TICK, True) for k in range(round(seconds / TICK))]
    assert arm.state == surg_core.State.ENABLED
    return [row for row in rows if row is not None]


@pytest.mark.parametrize(("depth", "goal"), [(0.07, 0.15), (0.034, None)])
def test_the_tips_force_under_random_loads_and_a_breathing_trocar(
    cell: surg_core.Cell, fit: LoadFit, full: bool, depth: float, goal: float | None
) -> None:
    rows = played(cell, fit, depth, 60.0 if full else 2.0 if goal else 0.6)
    good = [row for row in rows if row.estimate.valid]
    assert len(good) >= len(rows) - 2  # the window fills at the start
    tip = [r.estimate.forces.tip - r.tip for r in good if r.estimate.forces]
    trocar = [r.estimate.forces.trocar - r.trocar for r in good if r.estimate.forces]
    axial = [r.estimate.forces.axial - r.axial_tip for r in good if r.estimate.forces]
    ages = [(len(r.estimate.reason), r.age) for r in good]
    said = [r.estimate for r in good]
    held, kept = inside(said, tip, slice(0, 3)), inside(said, trocar, slice(3, 6))
    shallow = 1e3 * min(r.depth for r in good)
    print(
        f"depth {shallow:.1f} to {1e3 * max(r.depth for r in good):.1f} mm, {len(good)} estimates: "
        f"tip {rms(tip):.3f} N rms of {rms([r.tip for r in good]):.2f} (largest "
        f"{max(np.linalg.norm(r.tip) for r in good):.1f}), trocar {rms(trocar):.3f}; inside 95 %: "
        f"tip {held:.3f}, trocar {kept:.3f}; axial sum - tip's {np.std(axial):.2f} rms, "
        f"{np.abs(axial).max():.2f} largest; age {max(a for _, a in ages) * 1e3:.1f} ms"
    )
    assert max(a for _, a in ages) <= 0.010
    assert np.abs(axial).max() < 0.5 + 0.5  # the seal's friction, and five sigma of the sum
    if goal is not None:
        assert shallow >= 60.0
        assert rms(tip) <= goal
    if full:
        assert 0.90 <= held <= 0.99
        assert 0.90 <= kept <= 0.99


def test_free_motion_raises_no_alarm_of_the_force_guards(
    cell: surg_core.Cell, fit: LoadFit, full: bool
) -> None:
    alarms, cycles, largest = 0, 0, 0.0
    for seed in range(100 if full else 1):
        depth = 0.05 + 0.06 * (seed % 10) / 10
        arm = LoadedArm(cell, fit, seed=seed, depth=depth)
        arm.begin()
        for k in range(1500 if full else 400):
            arm.tick(k * TICK, False, force_guard=True)
            told = arm.told
            largest = max(largest, *(np.linalg.norm(f) for f in told)) if told else largest
            cycles += 1
        alarms += arm.state != surg_core.State.ENABLED
        alarms += arm.warned
    print(f"{alarms} alarms in {cycles} cycles; largest force told {largest:.2f} N")
    assert cycles and alarms == 0 and largest > 0.0
