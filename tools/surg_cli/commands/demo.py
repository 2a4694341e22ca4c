"""`./surg demo`: an operator's motion through the real graph into the simulator, and a report."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.commands import learn, run
from surg_cli.graph import follow, master, processes, running, system
from surg_cli.graph.system import Plan
from surg_cli.graph.watch import Watch
from surg_cli.host import cells, environment, paths
from surg_cli.host.terminal import Problem, Progress, say, table, warn

OPERATOR_TIMEOUT_S = 15.0
# Homing, the way to the start, settling and the last hold, for the progress line only.
AROUND_MOTION_S = 2.5
BUNDLED_MOTION = paths.ROOT / "src" / "surg_teleop" / "motions" / "bundled.csv"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--robot", default="ur5e", metavar="R", help="ur5e, panda, or the path of a robot's YAML")
    add("--motion", type=Path, metavar="FILE", help="motion CSV (default: the bundled one)")
    add("--scale", type=_positive, default=1.0, help="motion scale (default 1)")
    add("--duration", type=_positive, metavar="S", help="only the first S seconds of the motion")
    add("--mode", choices=("cartesian", "spherical"), default="cartesian", help="what is commanded")
    add("--link", choices=("joint", "twist"), help="what the robot obeys (default: its YAML)")
    add("--law", choices=("ours", "velocity", "paper"), default="ours", help="the control law")
    add("--feedback-gain", type=_gain, metavar="K", help="lateral feedback [1/s], 0 to 100")
    add("--seed", type=int, default=0, metavar="N", help="of the simulator's random numbers")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default runs/<UTC time>)")
    add("--free-run", action="store_true", help="in real time instead of lock-step")
    add("--no-video", action="store_true", help="without the endoscope camera")
    add("--view", action="store_true", help="open the simulator's window (needs a display)")
    add("--port", type=tcp_port, metavar="P", help="of the ROS master (default: a free one)")
    add(
        "--task",
        metavar="TASK",
        help="play a task instead of a motion, as ./surg run TASK does",
    )
    add("--full", action="store_true", help="learn a policy of bgr, as ./surg learn bgr does")
    run.add_options(parser)
    learn.add_options(parser)
    parser.set_defaults(episodes=None)


def main(options: argparse.Namespace, command: str) -> int:
    """Check everything, run, report; the last line printed is the path of summary.json."""
    _check_mixture(options, command)
    if options.full:
        options.task = "bgr"
        options.cameras = options.cameras != "none"
        return learn.main(options, command)
    if options.task is not None:
        options.episodes = 1 if options.episodes is None else options.episodes
        return run.main(options, command)
    if options.view and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise Problem("--view needs a display: neither DISPLAY nor WAYLAND_DISPLAY is set", 2)
    # Everything a person can get wrong is found before anything moves.
    out = paths.run_folder(options.out)
    try:
        cell = cells.for_robot(options.robot, out / "cell")
        loaded = cells.load(cell)
        arm = _only_arm(loaded, cell)
        motion = _check_motion(options, loaded.arms[arm])
    except Problem:
        _forget(out)
        raise
    out.mkdir(parents=True, exist_ok=True)
    plan = _plan(options, cell, arm, motion, out, loaded.arms[arm].robot)
    say(
        f"demo: {loaded.arms[arm].robot.name}, {motion.file.name}, {motion.duration_s:.1f} s at "
        f"scale {options.scale:g}, {options.mode}, "
        f"{'lock-step' if plan.lockstep else 'free-run'} -> {out}"
    )
    reasons = play(plan, motion.duration_s, options.port)
    for reason in reasons:
        warn(f"surg: {reason}")
    summary = make_report(out, reasons)
    print_summary(summary)
    # What ended the run early has been said above; here is what the report finds in the recording.
    for reason in summary["reasons"]:
        if reason not in reasons:
            warn(f"surg: {reason}")
    say(str(out / "summary.json"))
    return 0 if summary["ok"] else 1


def _check_mixture(options: argparse.Namespace, command: str) -> None:
    """Refuse options of a motion with a task, of a task with a motion, of neither with --full.

    Raises:
        Problem: Names those that must not be there.
    """
    parser = argparse.ArgumentParser()
    add_arguments(parser, command)
    of_task, shared = {"setting", "episodes", "cameras"}, {"task", "robot", "law", "seed", "out"}
    given = {name for name, value in vars(options).items() if value != parser.get_default(name)}
    if options.full:
        allowed = {"full", "setting", "episodes", "rollouts", "cameras", "robot", "seed", "out"}
        wrong, where = given - allowed, "without --full"
    elif "rollouts" in given:
        wrong, where = {"rollouts"}, "with --full"
    elif options.task is None:
        wrong, where = given & of_task, "with --task"
    else:
        wrong, where = given - of_task - shared, "without --task"
    if wrong:
        names = ", ".join(sorted(f"--{name.replace('_', '-')}" for name in wrong))
        raise Problem(f"{names}: only {where}", 2)


@dataclass(frozen=True)
class CheckedMotion:
    """A motion that fits.

    Attributes:
        file: The CSV.
        duration_s: What will be played of it, run-in and run-out included.
        whole: Whether it is the bundled motion at full length and size: only then the shaft's
            sweep is a measure of the run rather than of the motion.
    """

    file: Path
    duration_s: float
    whole: bool


def play(plan: Plan, duration_s: float, port: int | None) -> list[str]:
    """Run a plan with an operator to its end.

    Args:
        plan: What to start; its folder receives `episode/` and `logs/`.
        duration_s: Length of the motion, for the progress line.
        port: Of the master, None for a free one.

    Returns:
        Why the run failed, one sentence each; empty when it came to its end.

    Raises:
        Problem: When the system does not come up, or nothing was recorded.
    """
    env = environment.for_nodes(ros_home=plan.out / "logs" / "ros")
    processes.adopt_orphans()
    try:
        with processes.Supervisor(env, plan.out / "logs") as supervisor:
            return _supervise(plan, duration_s, port, supervisor)
    finally:
        with processes.signals_ignored():
            processes.end_orphans()


def _supervise(
    plan: Plan, duration_s: float, port: int | None, supervisor: processes.Supervisor
) -> list[str]:
    """Start the master, list the system as running, follow it."""
    port = port or master.free_port()
    master.start(supervisor, port)
    with running.announced("demo", port, plan.cell, supervisor.logs) as entry:
        return _follow(plan, duration_s, supervisor, entry)


def _follow(
    plan: Plan, duration_s: float, supervisor: processes.Supervisor, entry: running.System
) -> list[str]:
    """Start the nodes and watch them until the motion is over."""
    for node in system.nodes(plan):
        system.start(supervisor, node)
    os.environ.update(supervisor.env)
    reasons: list[str] = []
    with Watch(plan.arms) as watch, Progress("demo") as progress:
        watch.record(True)
        follow.wait_for(
            lambda: watch.recording is True, supervisor, progress.update, "the recorder"
        )
        operator = system.start(supervisor, system.operator_node(plan))
        entry.nodes = {child.name: child.process.pid for child in supervisor.children}
        entry.save()
        fault_at: float | None = None
        while not (watch.sim.get("done") or operator.exit_code == 0):
            time.sleep(0.05)
            seconds = float(watch.sim.get("sim_time_s") or 0.0)
            note = " ".join(f"{name} {state}" for name, state in watch.states.items())
            fraction = seconds / (duration_s + AROUND_MOTION_S)
            progress.update(fraction, f"{seconds:5.1f} s simulated, {note}")
            if watch.faulted and fault_at is None:
                fault_at = time.monotonic()
            reasons = follow.failure(watch, supervisor, fault_at, (f"/{system.OPERATOR}",))
            if reasons:
                break
        progress.update(1.0, "writing the recording")
        if not reasons:
            reasons = _operator_verdict(operator)
        reasons += follow.finish_recording(watch, supervisor)
    return reasons


def _operator_verdict(operator: processes.Child) -> list[str]:
    """What the operator says at its end; empty when it has played the whole motion."""
    if not processes.wait_until(lambda: operator.exit_code is not None, OPERATOR_TIMEOUT_S):
        return ["the operator did not end"]
    return [] if operator.exit_code == 0 else [follow.death_notice(operator)]


def make_report(out: Path, reasons: list[str]) -> dict[str, Any]:
    """Compute the figures, write summary.json, report.html and PNGs.

    Args:
        out: Folder of the run.
        reasons: Why the run failed, as far as the recording cannot know it.

    Returns:
        The summary, with `reasons` in it.

    Raises:
        Problem: When the episode cannot be read.
    """
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.reports import run_report

    with Progress("report"):
        try:
            summary: dict[str, Any] = run_report.make(out)
        except EpisodeError as error:
            raise Problem(f"no report: {error}") from error
    if reasons:
        summary["ok"] = False
        summary["reasons"] = [*reasons, *summary["reasons"]]
        paths.write_text(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    return summary


def print_summary(summary: dict[str, Any]) -> None:
    """Print the figures a person looks for first."""
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
    robot: Any,
) -> Plan:
    """Translate the options."""
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
    info = {
        "task": "motion file",
        "operator": "recorded motion",
        "robot": robot.name,
        "motion": str(motion.file),
        "scale": options.scale,
        "duration": options.duration,
        "mode": options.mode,
        "law": options.law,
        "link": options.link or ("twist" if by_twist else "joint"),
        "feedback_gain": options.feedback_gain,
        "seed": options.seed,
        "full_motion": motion.whole,
        "timing": "freerun" if options.free_run else "lockstep",
    }
    return Plan(
        cell=cell,
        arms=(arm,),
        lockstep=not options.free_run,
        cameras=() if options.no_video else ("left",),
        view=options.view,
        law=options.law,
        link=options.link,
        feedback_gain=options.feedback_gain,
        seed=options.seed,
        out=out,
        operator=operator,
        run_info=info,
    )


def _check_motion(options: argparse.Namespace, arm: Any) -> CheckedMotion:
    """Read the motion and fit it into the arm's workspace: the operator's own checks, made early.

    Raises:
        Problem: When it is broken or does not fit: file, line, value, what is allowed.
    """
    from surg_teleop.playback.motion_errors import MotionError
    from surg_teleop.playback.motion_file import read_motion
    from surg_teleop.playback.motion_plan import ConstantMotionError, make_plan
    from surg_teleop.playback.workspace_fit import Workspace

    file = (options.motion or BUNDLED_MOTION).absolute()
    limits = arm.limits
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    try:
        plan = make_plan(read_motion(file), workspace, options.scale, options.duration)
    except ConstantMotionError as error:
        raise Problem(str(error), 1) from error
    except MotionError as error:
        raise Problem(str(error), 2) from error
    whole = options.motion is None and options.duration is None and options.scale >= 1
    return CheckedMotion(file, plan.duration, whole)


def _only_arm(loaded: Any, cell: Path) -> str:
    """Name of the one arm of a cell."""
    names = list(loaded.arms)
    if len(names) != 1:
        raise Problem(f"{cell}: the demonstration drives one arm, this cell has {len(names)}", 2)
    return str(names[0])


def _forget(out: Path) -> None:
    """Remove what a refused run has written: the cell made for a robot from outside the tree."""
    shutil.rmtree(out / "cell", ignore_errors=True)
    with contextlib.suppress(OSError):
        out.rmdir()


def _number_between(text: str, low: float, high: float, allowed: str) -> float:
    """A finite number in a closed range, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
    return value


def _positive(text: str) -> float:
    """A positive finite number."""
    return _number_between(text, math.ulp(0.0), 1e6, "a positive number")


def _gain(text: str) -> float:
    """A feedback gain."""
    return _number_between(text, 0.0, 100.0, "0 to 100 (1/s)")


def tcp_port(text: str) -> int:
    """A TCP port that needs no root."""
    return int(_number_between(text, 1024, 65535, "a port from 1024 to 65535"))
