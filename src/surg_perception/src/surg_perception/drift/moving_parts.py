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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from surg_core.transforms import FloatArray

if TYPE_CHECKING:
    from surg_perception.drift.seen_shafts import SeenShaft

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


def place_derivatives(
    shafts: SeenShaft, parts: Sequence[Part], scope: str, origins: dict[str, FloatArray]
) -> FloatArray:
    """(N, 2, 3, P) of both ends of N shafts before the left eye, by the steps of all parts.

    Args:
        shafts: The shafts.
        parts: As `parts_of` gives them.
        scope: Name of the arm that holds the endoscope.
        origins: (3,) of each arm's base in the world [m].
    """
    D = np.zeros((*shafts.p_V.shape, parts[-1].at.stop))
    R_VW, R_VF = shafts.R_VW[:, None], (shafts.R_VW @ shafts.R_WF)[:, None]
    for part in parts:
        own = (shafts.arm == part.of)[:, None, None, None]
        if part.kind == CAMERA:
            D[..., part.at] = -_carried(shafts.p_V)
        elif part.kind == BASE:
            way = R_VW @ _carried(shafts.p_W - origins[part.of])
            D[..., part.at] = -way if part.of == scope else way * own
        elif part.kind == TOOL:
            D[..., part.at] = R_VF @ _carried(shafts.p_TipP_F) * own
        elif part.kind == LAG:
            D[..., part.at] = -shafts.v_V[..., None]
    return D


def turns(shafts: SeenShaft, parts: Sequence[Part], scope: str, steps: FloatArray) -> FloatArray:
    """(N, 3) rotation vectors by which steps (N, P) turn each shaft before the left eye."""
    R_VF, turned = shafts.R_VW @ shafts.R_WF, np.zeros((len(steps), 3))
    for part in parts:
        own, w = (shafts.arm == part.of)[:, None], steps[:, part.at][:, :3, None]
        if part.kind == CAMERA:
            turned -= w[..., 0]
        elif part.kind == BASE:
            way = (shafts.R_VW @ w)[..., 0]
            turned += -way if part.of == scope else way * own
        elif part.kind == TOOL:
            turned += (R_VF @ w)[..., 0] * own
    return turned


def _carried(p: FloatArray) -> FloatArray:
    """(..., 3, 6) how points (..., 3) move with a pose about whose origin they are stated."""
    x, y, z = np.moveaxis(p, -1, 0)
    rows = np.zeros((*p.shape, 6))
    rows[..., 0, 1], rows[..., 0, 2], rows[..., 1, 2] = z, -y, x
    rows[..., 1, 0], rows[..., 2, 0], rows[..., 2, 1] = -z, y, -x
    rows[..., 3:] = np.eye(3)
    return rows
