"""Converts a motion file to a path in the rcm frame.

Time line: a run-in from rest, the recorded motion (repeated for longer durations), and a run-out to
rest. The recorded motion is never altered. Run-in and run-out bring the tip smoothly to the
velocity of the first sample and to rest from the last one. Without a run-in the controller's
jerk-limited filter would start behind a moving target (4 mm at 0.1 m/s). The run-in of a recording
that starts at rest does not move.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from surg_core.arm_view import Array
from surg_teleop.playback.motion_file import Motion, MotionError
from surg_teleop.playback.motion_path import MotionPlan, end_phase
from surg_teleop.playback.quintic import Quintic
from surg_teleop.playback.workspace_fit import Workspace, box_centre, largest_scale

CENTRE_DEPTH = 0.120
"""[m] Depth of the centre of a motion's box, on the home shaft axis."""
RUN_MIN = 0.3
"""[s] Shortest run-in and run-out."""
RUN_ACCELERATION = 0.5
"""[m/s^2] Mean acceleration of the run-in and run-out: a quarter of the tip's limit."""
RETURN_SPEED = 0.05
"""[m/s] Mean speed of the return from the last to the first sample of a repeated motion."""
RETURN_MIN = 1.0
"""[s] Shortest return."""
MIN_EXTENT = 1e-3
"""[m] A motion whose box is smaller in every axis counts as constant."""
CHECK_STEP = 0.002
"""[s] The path is checked at this interval, one control cycle."""
MAX_SCALE, MIN_SCALE = 10.0, 0.01
MAX_DURATION = 24 * 3600.0


class ConstantMotionError(MotionError):
    """A motion that does not move."""


def make_plan(
    motion: Motion, workspace: Workspace, scale: float = 1.0, duration: float | None = None
) -> MotionPlan:
    """Centre a motion on the home shaft axis, check that it fits, and make its time line.

    The scale is arm metres per recorded metre, MIN_SCALE to MAX_SCALE. A motion shorter than the
    duration [s] is repeated, with a smooth return in between; None: once.

    Raises:
        ConstantMotionError: The motion does not move.
        MotionError: The path does not fit (the error states the largest scale that would), or scale
            or duration is out of range.
    """
    if not MIN_SCALE <= scale <= MAX_SCALE:
        raise MotionError(f"--scale: {scale}; allowed: {MIN_SCALE} to {MAX_SCALE}")
    if duration is not None and not 1.0 <= duration <= MAX_DURATION:
        raise MotionError(f"--duration: {duration} s; allowed: 1 to {MAX_DURATION:.0f} s")
    if not workspace.depth_min < CENTRE_DEPTH < workspace.depth_max:
        raise MotionError(
            f"the arm's depth range is {workspace.depth_min} to {workspace.depth_max} m; motions "
            f"are centred at {CENTRE_DEPTH} m, which must lie inside"
        )
    played = motion.duration if duration is None else duration
    whole, motion = motion, motion.cut(played)
    if duration is not None and duration < motion.duration + CHECK_STEP:
        played = motion.duration
    extent = scale * np.ptp(motion.p, axis=0)
    if extent.max() < MIN_EXTENT <= scale * np.ptp(whole.p, axis=0).max():
        raise ConstantMotionError(
            f"--duration {played:g}: in this time the motion moves the tip by {_mm(extent)} mm; at "
            f"least {1e3 * MIN_EXTENT:.0f} mm in one axis are needed; allowed: "
            f"{_shortest(whole, scale):.1f} to {MAX_DURATION:.0f} s"
        )
    if extent.max() < MIN_EXTENT:
        raise ConstantMotionError(
            f"{motion.file}: the motion is constant: at scale {scale:g} its box is "
            f"{_mm(extent)} mm; allowed: at least {1e3 * MIN_EXTENT:.0f} mm in one axis"
        )
    plan = _lay_out(motion, workspace, scale, played)
    _check_fit(plan, workspace, scale)
    return plan


def _shortest(motion: Motion, scale: float) -> float:
    """Shortest part of a motion [s], rounded up to 0.1 s, that moves enough."""
    extents = np.maximum.accumulate(motion.p, axis=0) - np.minimum.accumulate(motion.p, axis=0)
    first = int(np.argmax(scale * extents.max(axis=1) >= MIN_EXTENT))
    return max(1.0, float(np.ceil(10.0 * motion.t[first]) / 10.0))


def _lay_out(motion: Motion, workspace: Workspace, scale: float, played: float) -> MotionPlan:
    spline = motion.spline()
    zero = np.zeros(4)

    def state(t: float) -> tuple[Array, Array, Array]:
        return spline(t), spline(t, 1), spline(t, 2)

    first, last = state(0.0), state(motion.duration)
    distance = scale * float(np.linalg.norm(last[0][:3] - first[0][:3]))
    back = 0.0
    if played > motion.duration:
        back = max(RETURN_MIN, distance / RETURN_SPEED, abs(float(last[0][3] - first[0][3])))
    way_back = Quintic.between(last, first, back or RETURN_MIN)
    phase = end_phase(motion, played, back)
    if phase <= motion.duration:
        stop = state(phase)
    else:  # the window ends within a return: differentiate its polynomial
        c, u = way_back.coefficients, phase - motion.duration
        k = np.arange(6)[:, None]
        velocity = (k[1:] * c[1:] * u ** (k[1:] - 1.0)).sum(axis=0)
        acceleration = (k[2:] * (k[2:] - 1) * c[2:] * u ** (k[2:] - 2.0)).sum(axis=0)
        stop = way_back.at(np.array([u]))[0], velocity, acceleration
    run_in = max(RUN_MIN, scale * float(np.linalg.norm(first[1][:3])) / RUN_ACCELERATION)
    run_out = max(RUN_MIN, scale * float(np.linalg.norm(stop[1][:3])) / RUN_ACCELERATION)
    start = (first[0] - first[1] * run_in / 2.0, zero, zero)
    end = (stop[0] + stop[1] * run_out / 2.0, zero, zero)
    centre = box_centre(motion.p)
    return MotionPlan(
        motion=motion,
        workspace=workspace,
        scale=scale,
        p_0=start[0][:3],
        p_R0=np.array([0.0, 0.0, CENTRE_DEPTH]) + scale * (start[0][:3] - centre),
        roll_0=float(motion.roll[0]),
        run_in=run_in,
        played=played,
        run_out=run_out,
        back=back,
        _spline=spline,
        _in=Quintic.between(start, first, run_in),
        _back=way_back,
        _out=Quintic.between(stop, end, run_out),
        _gripper_closed=0.0 if motion.gripper is None else float(motion.gripper.min()),
        _knots=motion.t.tolist(),
        _pieces=list(spline.c[::-1].transpose(1, 0, 2)),
        _turns=_turns_of(motion, back),
    )


def _turns_of(motion: Motion, back: float) -> Slerp | None:
    """The tool's rotation over one repetition, with the return of a length [s] to its first."""
    if motion.turns is None:
        return None
    knots, turns = motion.t, motion.turns
    if back > 0.0:
        knots = np.append(knots, motion.duration + back)
        turns = np.concatenate([turns, turns[:1]])
    return Slerp(knots, Rotation.from_matrix(turns))


def _check_fit(plan: MotionPlan, workspace: Workspace, scale: float) -> None:
    # One repetition covers the whole path; a window that ends within a return adds its run-out.
    window = min(plan.played, plan.motion.duration + plan.back)
    times = np.concatenate(
        (
            np.arange(0.0, plan.run_in + window, CHECK_STEP),
            np.arange(plan.run_in + plan.played, plan.duration, CHECK_STEP),
            plan.run_in + plan.motion.t,
        )
    )
    p, _ = plan.path(times)
    offsets = (p - np.array([0.0, 0.0, CENTRE_DEPTH])) / scale
    first = largest_scale(offsets, CENTRE_DEPTH, workspace)
    if first.scale >= scale:
        return
    worst = p[first.index]
    depth = float(np.linalg.norm(worst))
    angle = math.degrees(math.acos(max(-1.0, min(1.0, worst[2] / depth))))
    # Rounded down, because the stated scale must fit.
    fits = math.floor(1000.0 * first.scale) / 1000.0
    box = _mm(scale * np.ptp(plan.motion.p, axis=0))
    raise MotionError(
        f"{plan.place(float(times[first.index]))}: at scale {scale:g} the "
        f"motion (box {box} mm, centred {1e3 * CENTRE_DEPTH:.0f} mm deep) does not fit: the tip "
        f"would be {1e3 * depth:.1f} mm deep and {angle:.1f} degrees off the home axis; allowed: "
        f"{1e3 * workspace.depth_min:.0f} to {1e3 * workspace.depth_max:.0f} mm and "
        f"{math.degrees(workspace.cone):.0f} degrees. The largest scale that fits is {fits:.3f}"
    )


def _mm(extent: Array) -> str:
    return " x ".join(f"{1e3 * value:.1f}" for value in extent)
