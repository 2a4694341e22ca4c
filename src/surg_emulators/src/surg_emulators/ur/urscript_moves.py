"""URScript's functions that command positions, and those that let the arm go."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import MAX_POSITION, JointMotion, Move, Servo, leading, timed
from surg_emulators.ur.line_motion import Arc, Line, circle
from surg_emulators.ur.urscript_arguments import close, cycles, matrix, number, six
from surg_emulators.ur.urscript_syntax import ScriptError
from surg_emulators.ur.urscript_threads import Builtin, Wait
from surg_emulators.ur.urscript_values import Pose

if TYPE_CHECKING:
    from surg_emulators.ur.ur_controller import UrController

LONGEST = 1e6
"""Longest time of a move [s], and largest blend radius [m]."""
ARRIVED = 1e-5
"""Distance of the tool from the goal at which a move with a time ends [m]."""


def positions(c: UrController) -> dict[str, Builtin]:
    """Functions that command positions, and those that let the arm go."""

    def movej(q: Any, a: Any = 1.4, v: Any = 1.05, t: Any = 0, r: Any = 0) -> Wait:
        goal = _joints(c, q)
        distance = leading([each - now for each, now in zip(goal, c.motion.q, strict=True)])
        a, v = _pace("movej", a, v, t, distance)
        c.motion.command = Move(goal, a, v, not c.motion.at_rest)
        return _until(c, goal, t, r)

    def along(goal: Any, a: Any, v: Any, t: Any, r: Any, kind: type[Line], **of: Any) -> Wait:
        X_BTcp, X_FTcp = _tool(c, goal), dh.pose_matrix(c.tcp_offset)
        if dh.inverse(X_BTcp, c.motion.q, c.table, X_FTcp) is None:
            c.protective_stop("the way of the tool leads out of reach")
            return Wait(1)
        line = kind(X_BTcp, 1.0, 1.0, c.table, X_FTcp, **of)
        a, v = _pace("a move of the tool", a, v, t, line.extent(line.way(c.motion.q)))
        c.motion.command = replace(line, a=a, v=v, turns=not c.motion.at_rest)
        return _until(c, None, t, r)

    def movel(pose: Any, a: Any = 1.2, v: Any = 0.25, t: Any = 0, r: Any = 0) -> Wait:
        return along(pose, a, v, t, r, Line)

    def movec(via: Any, pose: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0, mode: Any = 0) -> Wait:
        start = np.array(c.tcp_pose(c.motion.q)[:3])
        of = circle(start, _tool(c, via)[:3, 3], _tool(c, pose)[:3, 3])
        return along(pose, a, v, 0, r, Arc, **of, fixed=bool(mode))

    def movep(pose: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0) -> Wait:
        return movel(pose, a, v, 0, r)

    def servoj(
        q: Any, a: Any = 0, v: Any = 0, t: Any = 0.002, lookahead_time: Any = 0.1, gain: Any = 300
    ) -> Wait:
        number(gain, "servoj: gain", 100, 2000)
        lookahead = number(lookahead_time, "servoj: lookahead_time", 0.03, 0.2)
        c.motion.command = Servo(six(q, "servoj: q"), lookahead)
        return Wait(cycles(t), motion=True)

    def freedrive(on: bool) -> Builtin:
        def switch(*values: Any, **named: Any) -> None:
            c.guide(on)

        return switch

    return {
        "movej": movej,
        "movel": movel,
        "movec": movec,
        "movep": movep,
        "servoj": servoj,
        "freedrive_mode": freedrive(True),
        "teach_mode": freedrive(True),
        "end_freedrive_mode": freedrive(False),
        "end_teach_mode": freedrive(False),
        "protective_stop": lambda: c.protective_stop("asked for by the program"),
    }


def during(motion: JointMotion, t: Any) -> Wait:
    """A time [s] of motion: it lasts the longer, the more the motion is slowed down."""
    left = float(cycles(t))

    def over() -> bool:
        nonlocal left
        left -= motion.scale
        return left < 1e-6

    return Wait(1, over, motion=True)


def _joints(c: UrController, goal: Any) -> list[float]:
    """Joint positions of a goal, which may be a pose.

    Raises:
        ScriptError: There are none.
    """
    if not isinstance(goal, Pose):
        return [number(q, "a move: q", -MAX_POSITION, MAX_POSITION) for q in six(goal, "q")]
    solved = dh.inverse(matrix(goal), c.motion.q, c.table, dh.pose_matrix(c.tcp_offset))
    if solved is None:
        raise ScriptError("no joint positions for this pose")
    return solved


def _tool(c: UrController, goal: Any) -> dh.Matrix:
    """The tool's pose in `base` at a goal, which may be joint positions, (4, 4)."""
    if isinstance(goal, Pose):
        return matrix(goal)
    return matrix(c.tcp_pose(six(goal, "a move: q")))


def _pace(name: str, a: Any, v: Any, t: Any, distance: float) -> tuple[float, float]:
    """Acceleration and speed of a move; its time, where it has one, counts in their place."""
    seconds = number(t, f"{name}: t", 0.0, LONGEST)
    if seconds > 0.0 and distance > 0.0:
        return timed(distance, seconds)
    return number(a, f"{name}: a", 1e-6), number(v, f"{name}: v", 1e-6)


def _until(c: UrController, goal: list[float] | None, t: Any, r: Any) -> Wait:
    """The end of a move: at rest at its goal, after its time, or within its blend radius [m]."""
    radius = number(r, "a move: r", 0.0, LONGEST)
    if radius > 0.0:
        return Wait(2, lambda: _away(c, goal) < radius, motion=True)
    if t > 0:
        return Wait(cycles(t), lambda: _away(c, goal) < ARRIVED, motion=True)

    def there() -> bool:
        return c.motion.at_rest and (goal is None or close(c.motion.q, goal, 1.0))

    return Wait(2, there, motion=True)


def _away(c: UrController, goal: list[float] | None) -> float:
    """Distance of the tool from the goal of a move [m]."""
    if goal is None:
        assert isinstance(c.motion.command, Line)
        return float(np.linalg.norm(c.motion.command.way(c.motion.q)[:3]))
    there, here = c.tcp_pose(goal), c.tcp_pose(c.motion.q)
    return float(np.linalg.norm(np.subtract(there[:3], here[:3])))
