"""The simulated sensor at the flange, its bench, and `./surg calibrate CELL force` and `zero`."""

import argparse
import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.force import force_bench
from helpers.force.loaded_arm import SENSOR, pull_at_tip, sensing_cell
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_cli.robots import force_steps
from surg_core.force.compensation import external_wrench, gravity_in_base
from surg_core.force.force_file import load_force
from surg_core.force.sensor_file import load_sensor
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World
from surg_sim.sensing.flange_sensor import true_frame

GRASPER = 0.318
"""[kg] By its URDF: holder, shaft and two fingers."""


def test_a_sensor_leaves_the_simulation_bit_for_bit_as_it_is() -> None:
    cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
    plain, sensing = World(cell), World(sensing_cell())
    for k in range(60):
        command = {"PSM1": ArmCommand(velocity=0.05 * np.sin(k / 10) * np.ones(6))}
        plain.step(command)
        sensing.step(command)
    assert sensing.hash == plain.hash
    assert list(sensing.force_sensors) == ["PSM1"] and not plain.force_sensors


def test_the_truth_is_weight_plus_what_pulls_at_the_tip_and_at_the_trocar() -> None:
    cell = sensing_cell()
    world, arm = World(cell), cell.arms["PSM1"]
    sensor = world.force_sensors["PSM1"]
    stated = load_sensor(SENSOR)
    R_FS, p_FS = true_frame(stated)
    tip = world.model.body("PSM1_tip").id
    g_B = gravity_in_base(arm.X_WB[:3, :3])
    world.trocar("PSM1").point.jump(np.array([0.004, 0.002, 0.0]))
    for force in (np.zeros(3), np.array([2.0, 0.0, -1.0]), np.array([0.0, 3.0, 1.0])):
        for _ in range(150):
            pull_at_tip(world, tip, force)
            world.step({})
        X = arm.chain.forward(world.state("PSM1").q)
        origin, trocar = X[:3, 3] + X[:3, :3] @ p_FS, world.trocar("PSM1")
        levers = (
            (world.truth("PSM1").tip, force),
            (trocar.loaded, -trocar.force),
            # The weight of holder, shaft and closed fingers, from the URDF.
            ((X @ np.array([0.0365418, 0.0, 0.0432327, 1.0]))[:3], GRASPER * g_B * 9.81 / 9.80665),
        )
        moment = sum(np.cross(p - origin, f) for p, f in levers)
        expected = np.concatenate([sum(f for _, f in levers), moment])
        R_BS = X[:3, :3] @ R_FS
        read = np.concatenate([R_BS @ sensor.truth()[:3], R_BS @ sensor.truth()[3:]])
        np.testing.assert_allclose(read[:3], expected[:3], atol=0.01)
        np.testing.assert_allclose(read[3:], expected[3:], atol=0.001)
    assert np.linalg.norm(trocar.force) > 1.0


def test_readings_have_the_files_noise_bias_sign_and_range() -> None:
    world = World(sensing_cell())
    sensor = world.force_sensors["PSM1"]
    stated = load_sensor(SENSOR)
    errors = []
    for _ in range(400):
        sensor.sample()
        errors.append(sensor.reading - sensor.truth() - stated.bias)
    sd = np.std(errors, axis=0)
    np.testing.assert_allclose(sd, stated.noise, rtol=0.15)
    assert (np.abs(np.mean(errors, axis=0)) < 4 * stated.noise / 20 + 0.01 * stated.drift).all()
    sensor._sensor = dataclasses.replace(stated, largest=np.full(6, 0.5), sign=-1.0)
    sensor.sample()
    assert sensor.reading[0] == -0.5  # of a bias of 2 N


def options(source: Path | None, what: str = "force") -> argparse.Namespace:
    return argparse.Namespace(what=what, source=source, dry_run=False)


@pytest.fixture
def cell(tmp_path: Path) -> surg_core.Cell:
    """A folder with the sensor and the calibration of sim_ur5e."""
    calibration = paths.ROOT / "cells" / "sim_ur5e" / "calibration"
    shutil.copytree(calibration, tmp_path / "calibration")
    shutil.copy(SENSOR, tmp_path / "force_sensor_PSM1.yaml")
    whole = sensing_cell()
    arm = dataclasses.replace(whole.arms["PSM1"], force_sensor=tmp_path / "force_sensor_PSM1.yaml")
    return dataclasses.replace(whole, arms={"PSM1": arm}, folder=tmp_path)


def test_postures_from_the_bench_give_the_tools_mass_and_frame(
    cell: surg_core.Cell, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, arm = cell.folder, cell.arms["PSM1"]
    file = folder / "postures.csv"
    force_bench.ForceBench(cell, "PSM1", 1).record(file, 16)
    force_steps.run(folder, arm, options(file), "simulated", "2026-11-23")
    found = load_force(folder / "calibration" / "force_PSM1.yaml")
    stated = load_sensor(SENSOR)
    assert found.load.mass == pytest.approx(GRASPER, abs=0.001)
    np.testing.assert_allclose(found.load.bias[:3], stated.bias[:3], atol=0.005)
    np.testing.assert_allclose(found.load.R_FS, true_frame(stated)[0], atol=0.0015)
    assert found.condition < 20.0 and 0.5 < found.residual < 1.5
    assert "expected error" in capsys.readouterr().out

    # A zero keeps the load, and is refused when the tool is pressed or was changed.
    force_bench.ForceBench(cell, "PSM1", 2).record(file, 4)
    force_steps.run(folder, arm, options(file, "zero"), "simulated", "2026-11-23")
    again = load_force(folder / "calibration" / "force_PSM1.yaml")
    assert (again.load.mass, again.n) == (found.load.mass, 16)
    assert (again.load.bias != found.load.bias).all()
    force_bench.ForceBench(cell, "PSM1", 3).record(file, 4, np.array([0.0, 0.0, 0.3]))
    with pytest.raises(CliError, match="touches something"):
        force_steps.run(folder, arm, options(file, "zero"), "simulated", "2026-11-23")
    tool = folder / "calibration" / "tool_PSM1.yaml"
    tool.write_text(tool.read_text("utf-8") + "# changed\n", encoding="utf-8")
    force_bench.ForceBench(cell, "PSM1", 4).record(file, 4)
    with pytest.raises(CliError, match="tool_sha256"):
        force_steps.run(folder, arm, options(file, "zero"), "simulated", "2026-11-23")
    after = load_force(folder / "calibration" / "force_PSM1.yaml")
    np.testing.assert_array_equal(after.load.bias, again.load.bias)


def test_what_a_recording_must_not_hold_is_refused_by_file_and_line(cell: surg_core.Cell) -> None:
    folder, arm = cell.folder, cell.arms["PSM1"]
    file = folder / "postures.csv"
    force_bench.ForceBench(cell, "PSM1", 1).record(file, 12)
    lines = file.read_text("utf-8").splitlines()
    broken = {
        "header": [lines[0].replace("fx", "gx"), *lines[1:]],
        "12 values|13 values": [lines[0], lines[1].rpartition(",")[0], *lines[2:]],
        "not a finite number": [lines[0], lines[1].replace(",250", ",nan"), *lines[2:]],
        "is empty": ["# nothing"],
        "11 postures": lines[:-1],
    }
    for problem, text in broken.items():
        file.write_text("\n".join(text) + "\n", encoding="utf-8")
        with pytest.raises(CliError, match=problem):
            force_steps.run(folder, arm, options(file), "simulated", "2026-11-23")
    assert not (folder / "calibration" / "force_PSM1.yaml").exists()
    with pytest.raises(CliError, match="force_sensor_PSM1"):
        bare = dataclasses.replace(arm, force_sensor=None)
        force_steps.run(folder, bare, options(file), "simulated", "2026-11-23")


def test_the_estimate_of_a_free_tool_is_nothing(cell: surg_core.Cell) -> None:
    """The bench's readings, through the file's load, leave no force."""
    folder, arm = cell.folder, cell.arms["PSM1"]
    bench = force_bench.ForceBench(cell, "PSM1", 1)
    bench.record(folder / "postures.csv", 16)
    force_steps.run(folder, arm, options(folder / "postures.csv"), "simulated", "2026-11-23")
    load = load_force(folder / "calibration" / "force_PSM1.yaml").load
    g_B = gravity_in_base(arm.X_WB[:3, :3])
    for _ in range(10):
        q = bench.draw()
        left = external_wrench(load, bench.reading(q), arm.chain.forward(q)[:3, :3], g_B)
        assert np.abs(left[:3]).max() < 0.02 and np.abs(left[3:]).max() < 0.001
