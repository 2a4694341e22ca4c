"""`./surg calibrate`: from recorded poses to the calibration files of a cell.

`surg_core` solves, `./surg calibrate CELL collect` collects, the cell stores.
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path
from typing import Any

from surg_cli.host import cells
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import CliError, say, say_written
from surg_cli.robots import endoscope_steps, force_steps

MOTIONS = ("tip", "roll", "second", "trocar", "touch", "force")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("cell", metavar="CELL", help="name in cells/, or a cell's folder")
    add(
        "what",
        choices=(
            *("collect", "tool", "trocar", "bases", "live"),
            *(*force_steps.STEPS, *endoscope_steps.STEPS),
        ),
        help="record poses, solve for tool, trocar or bases, calibrate the force sensor (force, "
        "zero) or the endoscope (live: from the console's page)",
    )
    add(
        "motion",
        nargs="?",
        choices=MOTIONS,
        metavar="MOTION",
        help="collect: kind of the poses: " + ", ".join(MOTIONS),
    )
    add("--arm", metavar="NAME", help="of the cell (default: its only arm; bases: the second one)")
    add(
        "--from",
        dest="sources",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="the recording, CSV; bases: those of both arms; of the endoscope: the folder of views",
    )
    add(
        "--to",
        type=Path,
        metavar="FILE",
        help="collect: the recording, rows are appended; board: the PDF, or a PNG; --live: a new "
        "folder of views (default in runs/)",
    )
    add("--dry-run", action="store_true", help="solve and print, write nothing")
    add("--count", type=int, default=12, metavar="N", help="collect: poses (default 12)")
    add("--port", type=tcp_port, default=11311, metavar="P", help="of the ROS master")
    endoscope_steps.add_arguments(parser)


def main(options: argparse.Namespace, command: str) -> int:
    """Collect or solve."""
    if options.motion is not None and options.what != "collect":
        raise CliError(f"calibrate {options.what}: takes no {options.motion!r}", 2)
    both = options.what == "bases" and options.by is None
    if len(options.sources) > 1 and not both:
        raise CliError(f"calibrate {options.what}: --from takes one recording", 2)
    options.source = options.sources[0] if options.sources else None
    folder = cells.find(options.cell)
    cell = cells.load(folder)
    if options.what == "live" or options.live:
        from surg_cli.graph import live_views
        from surg_cli.graph.collect import system_at
        from surg_cli.robots import live_bases

        endoscope_steps.check_live(options, cell)
        origin = max(origin_of(arm) for arm in cell.arms.values())
        collecting = live_bases if options.what == "bases" else live_views
        with system_at(options.port, "calibrate", anonymous=False):
            return collecting.calibrate(cell, options, origin, today())
    if options.what in endoscope_steps.STEPS or options.by is not None:
        origin = max(origin_of(arm) for arm in cell.arms.values())  # simulated, if one of them is
        endoscope_steps.run(cell, options, origin, today())
        return 0
    if options.what == "bases":
        _bases(folder, cell, options)
        return 0
    arm = choose_arm(cell, options.arm)
    if options.what == "collect":
        from surg_cli.graph.collect import collect

        if options.to is None or options.motion is None:
            raise CliError(
                f"calibrate collect: MOTION ({', '.join(MOTIONS)}) and --to FILE are missing", 2
            )
        if options.count < 1:
            raise CliError(f"calibrate collect: --count {options.count}: 1 or more is allowed", 2)
        if options.motion == "force":
            from surg_cli.robots.collect_force import collect_forces

            return collect_forces(arm, options.to, options.count, options)
        return collect(arm, options.to, options.motion, options.count, options)
    if options.what in force_steps.STEPS:
        force_steps.run(folder, arm, options, origin_of(arm), today())
        return 0
    if options.source is None:
        raise CliError(f"calibrate {options.what}: --from FILE is missing", 2)
    solve(folder, arm, options.what, options.source, today(), options.dry_run)
    return 0


def today() -> str:
    """The date of a calibration."""
    return datetime.date.today().isoformat()


def choose_arm(cell: Any, name: str | None) -> Any:
    """The arm of a loaded cell with this CRTK name; None names the only arm.

    Raises:
        CliError: There is no such arm, or the cell has several and none is named.
    """
    arms = dict(cell.arms)
    if name is None and len(arms) == 1:
        return next(iter(arms.values()))
    if name not in arms:
        reason = "--arm is missing" if name is None else f"--arm {name}: no such arm"
        raise CliError(f"{reason}; the cell has {', '.join(arms)}", 2)
    return arms[name]


def solve(folder: Path, arm: Any, what: str, source: Path, date: str, dry_run: bool) -> None:
    """Solve a recording for ``what`` (`tool` or `trocar`), print the residuals, write the file.

    Raises:
        CliError: The recording cannot be read, or its poses do not determine the result.
    """
    import numpy as np

    from surg_core import calibration

    path = folder / "calibration" / f"{what}_{arm.name}.yaml"
    origin, serial = origin_of(arm), "" if arm.hardware is None else arm.hardware.serial
    note = f"Measured: ./surg calibrate {folder.name} {what} --from {source.name}"
    try:
        recording = read(source, arm)
        if what == "tool":
            solution = calibration.solve_tool(recording, date)
            before = np.asarray(arm.tool.p_FTip)
            say(f"tip    {_mm(solution.tool.p_FTip)} mm in the flange frame; {_fit(solution.tip)}")
            angle = np.degrees(np.arccos(np.clip(solution.tool.s_F @ arm.tool.s_F, -1.0, 1.0)))
            axis = solution.axis.fit
            say(
                f"shaft  {np.round(solution.tool.s_F, 6).tolist()}; n {axis.n}, rms "
                f"{np.degrees(axis.rms):.3f} deg, worst {np.degrees(axis.worst):.3f} deg, "
                f"condition {axis.condition:.1f}"
            )
            moved = 1e3 * np.linalg.norm(solution.tool.p_FTip - before)
            say(f"change {moved:.3f} mm and {angle:.3f} deg from the previous {path.name}")
            if not dry_run:
                calibration.write_tool(path, solution.tool, note, origin, serial)
        else:
            point = calibration.solve_trocar(recording, arm.tool, date)
            say(f"trocar {_mm(point.trocar.p_BRcm)} mm in the robot base; {_fit(point.point)}")
            moved = 1e3 * np.linalg.norm(point.trocar.p_BRcm - arm.trocar.p_BRcm)
            say(f"change {moved:.3f} mm from the previous {path.name}")
            if not dry_run:
                calibration.write_trocar(path, point.trocar, note, origin, serial)
    except (calibration.CalibrationError, OSError) as error:
        raise CliError(f"calibrate {what}: {error}; {path} is unchanged", 1) from error
    say_written(path, dry_run)


def read(source: Path, arm: Any) -> Any:
    """The recording of an arm.

    Raises:
        CliError: It is another arm's.
        CalibrationError: It cannot be read.
    """
    from surg_core.reading.calibration_recording import read_recording

    recording = read_recording(source, arm.chain, arm.robot.joint_names)
    force_steps.check_serial(source, recording, arm)
    return recording


def origin_of(arm: Any) -> str:
    """Where an arm's calibrations come from: `simulated`, also from an emulator, or `measured`."""
    emulated = arm.hardware is not None and arm.hardware.emulated
    return "simulated" if arm.link == "simulator" or emulated else "measured"


def _bases(folder: Path, cell: Any, options: argparse.Namespace) -> None:
    """Solve for the base of a second arm against the cell's first one, and write it.

    Raises:
        CliError: The options or recordings do not determine it.
    """
    import surg_core
    from surg_core import base_calibration, calibration

    names = list(cell.arms)
    if len(names) < 2:
        raise CliError(f"calibrate bases: the cell has one arm, {names[0]}; two are needed", 2)
    first, others = cell.arms[names[0]], names[1:]
    second = choose_arm(cell, options.arm or (others[0] if len(others) == 1 else None))
    if second is first:
        raise CliError(
            f"calibrate bases: --arm {first.name}: the cell's first arm keeps its base; allowed: "
            f"{', '.join(others)}, which is measured against it",
            2,
        )
    if len(options.sources) != 2:
        raise CliError(
            f"calibrate bases: --from FILE FILE is needed: `touch` by {first.name}, then by "
            f"{second.name}",
            2,
        )
    path = folder / "calibration" / f"base_{second.name}.yaml"
    date = today()
    try:
        points = [
            calibration.touched_points(read(file, arm), arm.tool)
            for file, arm in zip(options.sources, (first, second), strict=True)
        ]
        fit = base_calibration.solve_bases(*points)
        moved = surg_core.inverse_pose(second.X_WB) @ first.X_WB @ fit.X_B1B2
        say(
            f"{second.name} in {first.name}: n {fit.n}, rms {1e3 * fit.rms:.3f} mm, worst "
            f"{1e3 * fit.worst:.3f} mm (point {fit.worst_point}), condition {fit.condition:.1f}"
        )
        say(f"change {_mm(moved[:3, 3])} mm from the base believed before")
        if not options.dry_run:
            source = max(origin_of(first), origin_of(second))  # simulated, if one of them is
            note = f"Measured by touch: {', '.join(file.name for file in options.sources)}"
            _write_base(path, cell, fit, (date, source), note)
    except (calibration.CalibrationError, surg_core.ConfigError, OSError) as error:
        raise CliError(f"calibrate bases: {error}; {path} is unchanged", 1) from error
    say_written(path, options.dry_run)


def _write_base(path: Path, cell: Any, fit: Any, when_and_how: tuple[str, str], note: str) -> None:
    """Write a fit against the cell's first arm as a surg_base/1 file."""
    from surg_core import base_calibration, base_file
    from surg_core.reading.pose_evidence import NO_HASH, Evidence

    first = next(iter(cell.arms.values()))
    stated = cell.config.arms[0]
    covariance = base_calibration.in_axes(fit.covariance, first.X_WB[:3, :3])
    evidence = Evidence(covariance, fit.rms, fit.n, fit.condition, *when_and_how)
    base = base_file.BaseCalibration(
        X_WB=first.X_WB @ fit.X_B1B2,
        method="points",
        evidence=evidence,
        reference=first.name,
        reference_xyz=stated.base_xyz,
        reference_rpy=stated.base_rpy,
        camera_sha256=NO_HASH,
    )
    base_file.write_base(path, base, note)


def _mm(vector: Any) -> str:
    return "[" + ", ".join(f"{1e3 * float(value):.3f}" for value in vector) + "]"


def _fit(solution: Any) -> str:
    import numpy as np

    fit, sigma = solution.fit, 1e3 * float(np.sqrt(np.trace(solution.covariance)))
    return (
        f"n {fit.n}, rms {1e3 * fit.rms:.3f} mm, worst {1e3 * fit.worst:.3f} mm, condition "
        f"{fit.condition:.1f}, expected error {sigma:.3f} mm"
    )
