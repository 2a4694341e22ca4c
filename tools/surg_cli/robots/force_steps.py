"""Calibration of the force sensor at an arm's flange: the tool's load, and its zero."""

from __future__ import annotations

import argparse
import dataclasses
import datetime
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.host.terminal import CliError, say, say_written

STEPS = ("force", "zero")


def run(folder: Path, arm: Any, options: argparse.Namespace, origin: str, date: str) -> None:
    """Do the step ``options.what`` for an arm of the cell in ``folder``.

    Args:
        folder: Of the cell.
        arm: Loaded.
        options: Of the command.
        origin: ``measured`` or ``simulated``.
        date: Of the file.

    Raises:
        CliError: The step is refused; nothing was written.
    """
    from surg_core import CalibrationError, ConfigError

    what = options.what
    if arm.force_sensor is None:
        raise CliError(
            f"calibrate {what}: {folder}/force_sensor_{arm.name}.yaml: no such file; copy one of "
            "src/surg_description/force_sensors: it states the sensor between flange and tool",
            2,
        )
    if options.source is None:
        raise CliError(f"calibrate {what}: --from FILE is missing: postures of the free tool", 2)
    path = folder / "calibration" / f"force_{arm.name}.yaml"
    try:
        found = _solve(folder, arm, options, (origin, date), path)
        if not options.dry_run:
            from surg_core.force.force_file import write_force

            command = f"./surg calibrate {folder.name} {what} --from {options.source.name}"
            write_force(path, found, f"Measured: {command}")
    except (CalibrationError, ConfigError, OSError) as error:
        raise CliError(f"calibrate {what}: {error}; {path} is unchanged", 1) from error
    say_written(path, options.dry_run)


def check_serial(source: Path, recording: Any, arm: Any) -> None:
    """Refuse a recording of another arm.

    Raises:
        CliError: With both serials.
    """
    if arm.hardware is not None and recording.serial != arm.hardware.serial:
        found = f"is of {recording.serial!r}" if recording.serial else "has no column 'serial'"
        raise CliError(
            f"{source}: serial: the recording {found}, the cell's {arm.name} is "
            f"{arm.hardware.serial!r}: record it with this arm, ./surg calibrate CELL collect",
            2,
        )


def _solve(
    folder: Path, arm: Any, options: argparse.Namespace, evidence: tuple[str, str], path: Path
) -> Any:
    """The new calibration, with its figures printed."""
    from surg_core.force import force_file, load_solver
    from surg_core.force.compensation import gravity_in_base
    from surg_core.force.force_recording import read_forces
    from surg_core.force.sensor_file import load_sensor
    from surg_core.reading.pose_evidence import file_sha256

    sensor = load_sensor(arm.force_sensor)
    g_B = gravity_in_base(arm.X_WB[:3, :3])
    names = arm.robot.joint_names
    recording = read_forces(options.source, arm.chain, names, g_B, sensor.sign)
    check_serial(options.source, recording, arm)
    tool_file = folder / "calibration" / f"tool_{arm.name}.yaml"
    now = datetime.datetime.now(datetime.UTC)
    zeroed = now.strftime("%Y-%m-%dT%H:%M:%S")
    if options.what == "zero":
        old = force_file.load_force(path)
        force_file.check_current(old, path, tool_file, arm.force_sensor)
        hours = old.hours_since_zero(now)
        load, residual = load_solver.zero(old.load, recording.postures, sensor, hours)
        shift = load.bias - old.load.bias
        say(f"zero {_six(shift)} from the one of {old.zeroed} UTC; residual {residual:.2f} sigma")
        return dataclasses.replace(old, load=load, zeroed=zeroed)
    fit = load_solver.solve_load(recording.postures, sensor)
    _say_fit(fit)
    origin, date = evidence
    return force_file.ForceCalibration(
        load=fit.load,
        residual=fit.residual,
        condition=fit.condition,
        n=fit.n,
        date=date,
        zeroed=zeroed,
        source=origin,
        tool_sha256=file_sha256(tool_file),
        sensor_sha256=file_sha256(arm.force_sensor),
    )


def _say_fit(fit: Any) -> None:
    load, sd = fit.load, np.sqrt(np.diag(fit.load.covariance))
    centre = ", ".join(f"{1e3 * value:.2f}" for value in load.p_SCom)
    say(f"mass   {load.mass:.4f} kg, expected error {1e3 * sd[0]:.2f} g")
    say(f"centre [{centre}] mm in the sensor, expected error {1e3 * sd[1:4].max():.2f} mm")
    say(f"bias   {_six(load.bias)}, expected error {sd[4:7].max():.4f} N, {sd[7:10].max():.5f} N m")
    say(
        f"frame  expected error {np.degrees(sd[10:].max()):.3f} deg; n {fit.n}, residual "
        f"{fit.residual:.2f} sigma ({fit.force_rms:.4f} N, {fit.moment_rms:.5f} N m), condition "
        f"{fit.condition:.1f}"
    )


def _six(wrench: Any) -> str:
    force = ", ".join(f"{value:.3f}" for value in wrench[:3])
    moment = ", ".join(f"{value:.4f}" for value in wrench[3:])
    return f"[{force}] N, [{moment}] N m"
