"""The parts of the chain from a joint to a pixel that can move, and what a pixel says of each.

A point of an instrument is seen at ``pixel(X_EV X_VW X_WF(q) p_F)``. Each part has a small step; a
row of numbers is the derivative of the pixel by all steps together.

============== ==== =====================================================================
part           size step
============== ==== =====================================================================
camera         6    of the left eye's pose in its holder's flange, axes of the eye
base of an arm 6    of the arm's base in the world, axes of the world
lens           2    of an eye's picture: a lens that was seated anew shifts it [px]
tool of an arm 6    of the instrument in its flange, about the tip, axes of the flange
lag            1    of the pictures behind the joints [s]
============== ==== =====================================================================

A pose's step is a rotation vector [rad] and a shift [m], as in `small_motions`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray, skew

EYES = ("left", "right")
CAMERA, BASE, LENS, TOOL, LAG = "camera", "base", "lens", "tool", "lag"

POSE = np.radians(3.0), 0.010
"""[rad], [m] What a pose that moved may have moved by, one sigma: of one kind as of another."""
MOVED = {CAMERA: POSE, BASE: POSE, TOOL: POSE, LENS: (15.0,), LAG: (0.05,)}
"""The same of each kind: of a lens [px], of the lag [s]."""
STILL = {LENS: (0.3,), LAG: (0.003,)}
"""The same of a part that did not move, where no calibration states it: a lens's mount, a clock."""


@dataclass(frozen=True)
class Part:
    """One part.

    Attributes:
        kind: One of the five above.
        of: The arm or the eye; empty: of all.
        at: Its steps among all parameters.
        still: (k, k) covariance of the step while nothing moved, of the calibration.
    """

    kind: str
    of: str
    at: slice
    still: FloatArray

    @property
    def name(self) -> str:
        """Such as ``base of PSM1``."""
        return f"{self.kind} of {self.of}" if self.of else self.kind

    @property
    def moved(self) -> FloatArray:
        """(k, k) what the covariance of the step grows by if this part moved."""
        sd = np.repeat(MOVED[self.kind], 3 if self.at.stop - self.at.start == 6 else 1)
        if self.kind == LENS:
            sd = np.repeat(sd, 2)
        return np.diag(sd**2)


def parts_of(
    scope: str, arms: dict[str, FloatArray], bases: dict[str, FloatArray], camera: FloatArray
) -> list[Part]:
    """All parts in the order of their parameters.

    Args:
        scope: Name of the arm that holds the endoscope.
        arms: Of each arm whose instrument is seen, (6, 6) of its tool.
        bases: Of each arm, (6, 6) of its base in the world.
        camera: (6, 6) of the left eye in its flange.
    """
    stated: list[tuple[str, str, FloatArray]] = [(CAMERA, "", camera)]
    stated += [(BASE, name, bases[name]) for name in (scope, *arms)]
    stated += [(LENS, eye, STILL[LENS][0] ** 2 * np.eye(2)) for eye in EYES]
    stated += [(TOOL, name, still) for name, still in arms.items()]
    stated += [(LAG, "", STILL[LAG][0] ** 2 * np.eye(1))]
    parts, begin = [], 0
    for kind, of, still in stated:
        parts.append(Part(kind, of, slice(begin, begin + len(still)), still))
        begin += len(still)
    return parts


@dataclass(frozen=True)
class SeenPoint:
    """A point of an instrument as its joints put it before an eye.

    Attributes:
        arm: Whose instrument.
        eye: ``left`` or ``right``.
        p_V: (3,) before the left eye [m].
        v_V: (3,) its speed there, by the joints [m/s].
        p_W: (3,) in the world [m].
        p_TipP_F: (3,) from the tip, in the flange's axes [m].
        R_VW: (3, 3).
        R_WF: (3, 3) of the flange that carries it.
        by_point: (m, 3) derivative by p_V of the pixel [px/m], or of the place itself: (3, 3).
        per_pixel: What one pixel is in the same unit, across the view.
    """

    arm: str
    eye: str
    p_V: FloatArray
    v_V: FloatArray
    p_W: FloatArray
    p_TipP_F: FloatArray
    R_VW: FloatArray
    R_WF: FloatArray
    by_point: FloatArray
    per_pixel: float = 1.0


def derivatives(
    point: SeenPoint, parts: list[Part], scope: str, origins: dict[str, FloatArray]
) -> FloatArray:
    """(m, P) of what `by_point` is the derivative of, by the steps of all parts.

    Args:
        point: The point.
        parts: As `parts_of` gives them.
        scope: Name of the arm that holds the endoscope.
        origins: (3,) of each arm's base in the world [m].
    """
    rows = np.zeros((len(point.by_point), parts[-1].at.stop))
    by_world = point.by_point @ point.R_VW
    for part in parts:
        if part.kind == CAMERA:
            rows[:, part.at] = point.by_point @ np.hstack([skew(point.p_V), -np.eye(3)])
        elif part.kind == BASE and part.of in (scope, point.arm):
            carried = np.hstack([-skew(point.p_W - origins[part.of]), np.eye(3)])
            rows[:, part.at] = by_world @ carried * (-1.0 if part.of == scope else 1.0)
        elif part.kind == LENS and part.of == point.eye:
            rows[:2, part.at] = point.per_pixel * np.eye(2)
        elif part.kind == TOOL and part.of == point.arm:
            carried = np.hstack([-skew(point.p_TipP_F), np.eye(3)])
            rows[:, part.at] = by_world @ point.R_WF @ carried
        elif part.kind == LAG:
            rows[:, part.at] = -(point.by_point @ point.v_V)[:, None]
    return rows
