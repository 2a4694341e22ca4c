"""URScript's force mode: along chosen axes the tool yields to a force, along the others it rests.

Nothing here has a mass: the tool's speed is a share of the force that is wanting (assumed). A
motion beside force mode is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import BRAKING, REST, Speed, Vector
from surg_emulators.ur.line_motion import DAMPING
from surg_emulators.ur.urscript_arguments import matrix, six
from surg_emulators.ur.urscript_syntax import ScriptError
from surg_emulators.ur.urscript_threads import Builtin

if TYPE_CHECKING:
    from surg_emulators.ur.ur_controller import UrController

YIELD = np.array([0.01] * 3 + [0.1] * 3)
"""Speed of the tool for a force that is wanting [m/s per N, rad/s per Nm]. Assumed."""
UNTRANSFORMED = 2
"""The one type of task frame that is emulated: it stays where it is."""
MOTIONS = ("movej", "movel", "movec", "movep", "servoj", "speedj", "speedl")


@dataclass(frozen=True)
class Comply:
    """Apply a wrench along some axes of a frame, and rest along the others.

    Attributes:
        R_BTask: Axes of the task frame in `base`, (3, 3).
        free: Whether each axis is compliant, (6,).
        wrench: That the tool shall apply, in the task frame, (6,) [N, Nm].
        most: Largest speed along each compliant axis, (6,) [m/s, rad/s].
        felt: Gives what pushes at the tool in `base`, (6,) [N, Nm].
        jacobian: Of the tool centre point in `base`, (6, 6), at joint positions.
    """

    R_BTask: dh.Matrix
    free: dh.Matrix
    wrench: dh.Matrix
    most: dh.Matrix
    felt: Callable[[], Vector]
    jacobian: Callable[[Vector], dh.Matrix]

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`."""
        R = np.kron(np.eye(2), self.R_BTask)
        wanting = self.wrench + R.T @ np.array(self.felt())
        twist = R @ np.where(self.free, np.clip(YIELD * wanting, -self.most, self.most), 0.0)
        J = self.jacobian(q)
        rates = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), twist)
        return Speed([float(rate) for rate in rates], BRAKING).velocity(q, qd, dt)


def forces(c: UrController) -> dict[str, Builtin]:
    """The functions of force mode."""

    def force_mode(frame: Any, selection: Any, wrench: Any, kind: Any, limits: Any) -> None:
        if kind != UNTRANSFORMED:
            raise ScriptError(f"force_mode: type {kind!r} is not emulated, only {UNTRANSFORMED}")
        c.motion.command = Comply(
            matrix(frame)[:3, :3],
            np.array(six(selection, "force_mode: selection_vector")) != 0.0,
            np.array(six(wrench, "force_mode: wrench")),
            np.abs(six(limits, "force_mode: limits")),
            lambda: c.wrench,
            lambda q: dh.jacobian(q, c.table, dh.pose_matrix(c.tcp_offset)),
        )

    def end_force_mode() -> None:
        if isinstance(c.motion.command, Comply):
            c.motion.command = REST

    return {"force_mode": force_mode, "end_force_mode": end_force_mode}


def alone(c: UrController, name: str, motion: Builtin) -> Builtin:
    """The motion, which is refused in force mode."""

    def refuse_beside(*values: Any, **named: Any) -> Any:
        if isinstance(c.motion.command, Comply):
            raise ScriptError(f"{name} in force mode is not emulated")
        return motion(*values, **named)

    return refuse_beside
