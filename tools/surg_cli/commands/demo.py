"""`./surg demo`: an operator's motion through the real graph into the simulator, and a report."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.graph import episode_film, motion_run
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import cells, link_environments, paths, preflight
from surg_cli.host.option_types import positive
from surg_cli.host.terminal import CliError, Progress, say, table, warn
from surg_cli.robots import emulated_arms

OPEN_LOOP = "open-loop"
"""The velocity law without lateral feedback."""
BUNDLED_MOTION = paths.ROOT / "src" / "surg_teleop" / "motions" / "bundled.csv"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    robots = ", ".join(cells.described_robots())
    add(
        "--robot",
        default="ur5e",
        metavar="R",
        help=f"{robots}, the path of a robot's YAML, or a cell with one arm; an arm with a link of "
        "its own is emulated, in real time: emulated_ur5e, emulated_ur5e_wrist, emulated_panda, "
        "emulated_fr3",
    )
    add("--motion", type=Path, metavar="FILE", help="motion CSV (default: the bundled one)")
    add("--scale", type=positive, default=1.0, help="motion scale (default 1)")
    add("--duration", type=positive, metavar="S", help="only the first S seconds of the motion")
    add("--mode", choices=("cartesian", "spherical"), default="cartesian", help="command space")
    add("--link", choices=("joint", "twist"), help="command of the robot link (default: its YAML)")
    add(
        "--law",
        choices=("ours", "velocity", "paper", OPEN_LOOP),
        default="ours",
        help="the control law",
    )
    add("--seed", type=int, default=0, metavar="N", help="seed of the simulator")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    add("--free-run", action="store_true", help="in real time instead of lock-step")
    add("--no-video", action="store_true", help="without the endoscope camera")


def main(options: argparse.Namespace, command: str) -> int:
    """Check everything, run, report; the last line printed is the path of summary.json."""
    # All input is checked before anything moves.
    out = paths.run_folder(options.out)
    preflight.check_space(out)
    try:
        cell = cells.for_robot(options.robot, out / "cell")
        loaded = cells.load(cell)
        arm = _only_arm(loaded, cell)
        _prepare_link(options, cell, loaded)
        motion = _check_motion(options, loaded.arms[arm])
    except CliError:
        shutil.rmtree(out / "cell", ignore_errors=True)  # made for a robot given by its YAML
        with contextlib.suppress(OSError):
            out.rmdir()
        raise
    out.mkdir(parents=True, exist_ok=True)
    plan = _plan(options, cell, arm, motion, out, loaded.arms[arm])
    say(
        f"demo: {loaded.arms[arm].robot.name}, {motion.file.name}, {motion.duration_s:.1f} s at "
        f"scale {options.scale:g}, {options.mode}, "
        f"{'lock-step' if plan.lockstep else 'free-run'} -> {out}"
    )
    robots = emulated_arms.EmulatedArms(cell, loaded.arms)
    reasons = motion_run.play(plan, motion.duration_s, robots)
    for reason in reasons:
        warn(f"surg: {reason}")
    if plan.cameras:
        episode_film.for_report([out / "episode"], cell, out)
    summary = make_report(out, reasons)
    print_summary(summary)
    # The reasons printed above ended the run early; these come from the recording.
    for reason in summary["reasons"]:
        if reason not in reasons:
            warn(f"surg: {reason}")
    say(str(out / "report.html"))
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


@dataclass(frozen=True)
class CheckedMotion:
    """A motion that fits, and the seconds of it that are played, run-in and run-out included.

    ``whole``: it is the bundled motion at full length and size. Only then does the shaft's sweep
    measure the run rather than the motion.
    """

    file: Path
    duration_s: float
    whole: bool


def make_report(out: Path, reasons: list[str]) -> dict[str, Any]:
    """Write summary.json, report.html and PNGs; returns the summary.

    ``reasons`` are those for a failure that the recording cannot know.

    Raises:
        CliError: The episode cannot be read.
    """
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.reports import run_report

    with Progress("report"):
        try:
            summary: dict[str, Any] = run_report.make(out)
        except EpisodeError as error:
            raise CliError(f"no report: {error}") from error
    if reasons:
        summary["ok"] = False
        summary["reasons"] = [*reasons, *summary["reasons"]]
        paths.write_text(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    return summary


def print_summary(summary: dict[str, Any]) -> None:
    """Print the main figures."""
    rows = [
        ["RCM deviation, kinematic [mm]", _numbers(summary, "rcm_kinematic_mm")],
        ["RCM deviation, true [mm]", _numbers(summary, "rcm_true_mm")],
        ["tip error, lag removed [mm]", _numbers(summary, "tip_error_mm")],
        ["tip lag [ms]", _number(summary.get("tip_lag_ms"))],
        ["path length [mm]", _numbers(summary, "path_length_mm")],
        ["shaft sweep [deg]", _number(summary.get("shaft_sweep_deg"))],
        ["enabled, unscaled", _fractions(summary)],
        ["trocar force [N]", _numbers(summary.get("trocar") or {}, "force_n")],
        ["deterministic", str(summary.get("deterministic"))],
        ["state hash", str(summary.get("state_hash"))[:16]],
    ]
    say(table(rows))


def _numbers(values: dict[str, Any], key: str) -> str:
    """The members of one entry as `name value`."""
    entry = values.get(key)
    if not isinstance(entry, dict):
        return "not measured"
    return "  ".join(f"{name} {_number(value)}" for name, value in entry.items())


def _number(value: Any) -> str:
    """Four figures, or words for none."""
    if isinstance(value, (int, float)) and math.isfinite(value):
        return f"{value:.4g}"
    return "not measured"


def _fractions(summary: dict[str, Any]) -> str:
    """Shares of the cycles, in percent."""
    values = (summary.get("enabled_fraction"), summary.get("unscaled_fraction"))
    shown = [100 * v if isinstance(v, (int, float)) else None for v in values]
    return ", ".join(f"{_number(value)} %" for value in shown)


def _plan(
    options: argparse.Namespace,
    cell: Path,
    arm: str,
    motion: CheckedMotion,
    out: Path,
    loaded: Any,
) -> SystemPlan:
    """Translate the options."""
    robot, driven = loaded.robot, loaded.hardware is not None
    by_twist = "cartesian" in str(robot.command)
    operator: dict[str, object] = {
        "cell": str(cell),
        "arm": arm,
        "motion": str(motion.file),
        "scale": float(options.scale),
        "mode": options.mode,
        "lockstep": not options.free_run,
    }
    if options.duration is not None:
        operator["duration"] = float(options.duration)
    open_loop = options.law == OPEN_LOOP
    law = "velocity" if open_loop else options.law
    info = {
        "task": "motion file",
        "operator": "recorded motion",
        "robot": robot.name,
        "motion": str(motion.file),
        "scale": options.scale,
        "duration": options.duration,
        "mode": options.mode,
        "law": law,
        "link": options.link or ("twist" if by_twist else "joint"),
        "feedback_gain": 0.0 if open_loop else None,
        "seed": options.seed,
        "full_motion": motion.whole,
        "timing": "freerun" if options.free_run else "lockstep",
    }
    return SystemPlan(
        cell=cell,
        arms=(arm,),
        lockstep=not options.free_run,
        simulated=() if driven else None,
        driven=(arm,) if driven else (),
        turned=(arm,) if driven and loaded.hardware.tool_link == "drive" else (),
        cameras=() if options.no_video else ("left",),
        law=law,
        link=options.link,
        feedback_gain=0.0 if open_loop else None,
        seed=options.seed,
        out=out,
        operator=operator,
        run_info=info,
    )


def _check_motion(options: argparse.Namespace, arm: Any) -> CheckedMotion:
    """Read the motion and fit it into the arm's workspace, as the operator node does later."""
    from surg_teleop.playback.motion_file import MotionError, read_motion
    from surg_teleop.playback.motion_plan import ConstantMotionError, make_plan
    from surg_teleop.playback.workspace_fit import Workspace

    file = (options.motion or BUNDLED_MOTION).absolute()
    limits = arm.limits
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    try:
        plan = make_plan(read_motion(file), workspace, options.scale, options.duration)
    except ConstantMotionError as error:
        raise CliError(str(error), 1) from error
    except MotionError as error:
        raise CliError(str(error), 2) from error
    whole = options.motion is None and options.duration is None and options.scale >= 1
    return CheckedMotion(file, plan.duration, whole)


def _prepare_link(options: argparse.Namespace, cell: Path, loaded: Any) -> None:
    """Make a cell ready whose arm has a link of its own: in real time, without the simulator.

    Raises:
        CliError: The arm is a real one, or its link is started by hand.
    """
    (arm,) = loaded.arms.values()
    if arm.link == "simulator":
        return
    emulated_arms.refuse_real(loaded.arms, f"demo --robot {cell.name}")
    if arm.hardware is None:
        raise CliError(f"demo --robot {cell.name}: its link {arm.link!r} is started by hand", 2)
    link_environments.make_ready(arm)
    options.free_run = options.no_video = True


def _only_arm(loaded: Any, cell: Path) -> str:
    """Name of the one arm of a cell."""
    names = list(loaded.arms)
    if len(names) != 1:
        raise CliError(f"{cell}: the demonstration drives one arm, this cell has {len(names)}", 2)
    return str(names[0])
