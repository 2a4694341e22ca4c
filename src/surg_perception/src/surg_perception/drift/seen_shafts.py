"""What the seen middles of shafts say of all steps: residuals, and derivatives at any steps.

A shaft is straight before an eye, and in the plane z = 1 of its lens. A point that is seen on its
middle is compared with the nearest point of the shaft as joints and steps put it there: along
itself nobody sees a shaft move.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surg_core.lens_file import Lens
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.transforms import FloatArray
from surg_perception.drift.moving_parts import EYES, LAG, LENS, Part, place_derivatives, turns

NEAREST = 0.3
"""Least depth of a shaft after steps, relative to before; of its line, to the shaft's. Nearer,
derivatives explode."""

THROWN = 1e3
"""[px] So far beside its place is what steps cannot explain."""
FARTHEST = 3.0
"""Lengths of the piece of shaft beyond its ends at which its line is still looked at."""


class SeenShaft(NamedTuple):
    """One instrument in one pair of pictures; its piece of shaft goes from the lower end upwards.

    Of N `stacked` ones each member has one more axis in front.

    Attributes:
        stamp: When [s].
        arm: Whose instrument.
        p_V: (2, 3) both ends before the left eye, by the joints [m].
        v_V: (2, 3) their speed there [m/s].
        a_V: (2, 3) and their acceleration [m/s^2].
        p_W: (2, 3) in the world.
        p_TipP_F: (2, 3) from the tip, in the flange's axes.
        R_VW: (3, 3).
        R_WF: (3, 3) of the flange that carries it.
        pixels: (2, 2, 2) of each eye: two points of the seen middle; NaN: it is not seen.
        sd: (2,) of each eye: noise of a point across the shaft [px].
    """

    stamp: Any
    arm: Any
    p_V: FloatArray
    v_V: FloatArray
    a_V: FloatArray
    p_W: FloatArray
    p_TipP_F: FloatArray
    R_VW: FloatArray
    R_WF: FloatArray
    pixels: FloatArray
    sd: FloatArray


class Rows(NamedTuple):
    """Of N shafts with up to two points in each eye: residual ``r = A x + noise``; P steps.

    Attributes:
        A: (N, 4, P) derivatives; zeros: not seen.
        r: (N, 4) residuals [px].
        sd: (N, 4) of their noise [px].
        place: (N, 3, P) how far the lower end then lies beside the place that joints give it,
            across the shaft [m].
    """

    A: FloatArray
    r: FloatArray
    sd: FloatArray
    place: FloatArray


def stacked(shafts: Sequence[SeenShaft]) -> SeenShaft:
    """All in one."""
    return SeenShaft._make(map(np.array, zip(*shafts, strict=True)))


class ShaftRows:
    """Rows of shafts that are seen in one cell.

    Args:
        parts: All that can move.
        scope: Name of the arm that holds the endoscope.
        origins: (3,) of each arm's base in the world [m].
        lenses: Of one eye or two, for the pictures' size.
        X_LR: (4, 4) the right eye in the left one [m]; None: there is one eye.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        scope: str,
        origins: dict[str, FloatArray],
        lenses: Sequence[Lens],
        X_LR: FloatArray | None,
    ) -> None:
        poses = [np.eye(4)] if X_LR is None else [np.eye(4), X_LR]
        self.eyes = [EyeProjection(lens, X) for lens, X in zip(lenses, poses, strict=False)]
        self.focal = float(lenses[0].K[0, 0])
        self.steps = parts[-1].at.stop
        self._parts, self._scope, self._origins = list(parts), scope, origins
        self._of_eye = {part.of: part.at for part in parts if part.kind == LENS}
        (self._lag,) = (part.at for part in parts if part.kind == LAG)

    def at(self, shafts: SeenShaft, x: FloatArray) -> Rows:
        """Residuals, and derivatives that hold at the steps x (P,).

        A shaft that such steps throw into the lens, or out of the view, they do not explain: it is
        `THROWN` beside its place whatever the steps.
        """
        N = len(shafts.stamp)
        steps = np.tile(x, (N, 1))
        D, there_V, slope = self._stepped(shafts, steps)
        z = shafts.p_V[..., 2]
        thrown = (there_V[..., 2] < NEAREST * z).any(axis=1)
        planes = [self._plane(shafts, eye, steps) for eye in range(len(self.eyes))]
        for eye, m in enumerate(planes):
            thrown |= np.isfinite(shafts.pixels[:, eye]).any(axis=(1, 2)) & ~_whole(m)
        A, r, sd = np.zeros((N, 4, self.steps)), np.zeros((N, 4)), np.ones((N, 4))
        for eye, m in enumerate(planes):
            seen, rows = _whole(m) & ~thrown, slice(2 * eye, 2 * eye + 2)
            by_steps, beside, in_view = self._of_points(eye, m[seen], slope[seen], there_V[seen])
            A[seen, rows] = by_steps
            r[seen, rows] = beside + np.einsum("nkp,np->nk", by_steps, steps[seen])
            sd[seen, rows] = shafts.sd[seen, eye, None]
            thrown[seen] |= ~in_view
        A[thrown], r[thrown] = 0.0, THROWN
        return Rows(A, r, sd, self._place(shafts, D))

    def moved(self, shafts: SeenShaft, x: FloatArray) -> FloatArray:
        """(N, 2, 3) both ends before the left eye after the steps x (P,)."""
        return self._stepped(shafts, np.tile(x, (len(shafts.stamp), 1)))[1]

    def of_lens(self, eye: int, x: FloatArray) -> FloatArray:
        """(2,) what the steps x (P,) shift an eye's picture by [px]."""
        return np.asarray(x[self._of_eye[EYES[eye]]])

    def _of_points(
        self, eye: int, m: FloatArray, slope: FloatArray, there_V: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Derivatives (n, 2, P) and residuals (n, 2) of two points (n, 2, 2) of the plane z = 1.

        And (n,) whether the shaft then lies in the view.
        """
        view = self.eyes[eye]
        ends = view.plane(there_V)
        along = ends[:, 1] - ends[:, 0]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        a, b = view.before(there_V[:, 0]), view.before(there_V[:, 1]) - view.before(there_V[:, 0])
        # The point a + u b of the shaft that is seen beside m: along . (xy / z - m) = 0.
        t = np.einsum("nc,nkc->nk", along, m)
        up, down = (np.einsum("nc,nc->n", along, q[:, :2])[:, None] - t * q[:, 2:] for q in (a, b))
        u = _before_the_eye(-up / down, a[:, 2:], b[:, 2:])[..., None]
        q = a[:, None] + u * b[:, None]
        p_V = there_V[:, :1] + u * (there_V[:, 1:] - there_V[:, :1])
        in_view = view.sees(p_V).all(axis=1)
        p_V[~in_view] = 0.0, 0.0, 1.0  # on the axis: beyond the view the formula explodes
        by_point, per_pixel = view.slopes(p_V)
        n_pixel = np.einsum("nc,nkcd->nkd", normal, per_pixel)  # noise is of the picture
        size = np.linalg.norm(n_pixel, axis=-1)
        r = np.einsum("nc,nkc->nk", normal, m - q[..., :2] / q[..., 2:]) / size
        n_pixel /= size[..., None]
        by_place = np.einsum("nkd,nkds->nks", n_pixel, by_point)
        between = slope[:, :1] + u[..., None] * (slope[:, 1:] - slope[:, :1])
        A = np.einsum("nks,nksp->nkp", by_place, between)
        A[..., self._of_eye[EYES[eye]]] = n_pixel
        return A, r, in_view

    def _plane(self, shafts: SeenShaft, eye: int, steps: FloatArray) -> FloatArray:
        """(N, 2, 2) the seen points in the plane z = 1, the lens moved back by its steps (N, P)."""
        pixels = shafts.pixels[:, eye] - steps[:, None, self._of_eye[EYES[eye]]]
        seen, m = _whole(pixels), np.full(pixels.shape, np.nan)
        m[seen] = self.eyes[eye].plane_of(pixels[seen].reshape(-1, 2)).reshape(-1, 2, 2)
        return m

    def _moving(self, steps: FloatArray) -> FloatArray:
        """The steps (N, P) that move a shaft before the eye: not those of lenses."""
        moving = steps.copy()
        for at in self._of_eye.values():
            moving[:, at] = 0.0
        return moving

    def _stepped(
        self, shafts: SeenShaft, steps: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """After the steps (N, P): (N, 2, 3, P), (N, 2, 3) and (N, 2, 3, P).

        Derivatives half way there, where a chord has the slope of its arc; both ends; how more
        steps move these.
        """
        moving, known = self._moving(steps), (self._parts, self._scope)
        D = place_derivatives(shafts, *known, self._origins)
        half_V = np.einsum("nesp,np->nes", D, moving) / 2.0
        p_F = shafts.p_TipP_F
        size = np.linalg.norm(p_F[:, 1] - p_F[:, 0], axis=1)[:, None]
        turned_V = (half_V[:, 1] - half_V[:, 0]) / size
        turned_F = np.einsum("ni,nij,njk->nk", turned_V, shafts.R_VW, shafts.R_WF)
        late = shafts.a_V * steps[:, None, self._lag] / 2.0
        between = shafts._replace(
            p_V=shafts.p_V + half_V,
            v_V=shafts.v_V - late,
            p_W=shafts.p_W + half_V @ shafts.R_VW,
            p_TipP_F=p_F + np.linalg.norm(p_F, axis=2)[..., None] * turned_F[:, None],
        )
        half = place_derivatives(between, *known, self._origins)
        # Of the chord D(p + D(p) x / 2) x: D is affine in p, by the turn of all steps.
        w = turns(shafts, *known, moving)[:, None, :, None]
        slope = half + 0.5 * np.cross(w, D, axis=2)
        slope[..., self._lag] += late[..., None]
        return half, shafts.p_V + np.einsum("nesp,np->nes", half, moving), slope

    def _place(self, shafts: SeenShaft, D: FloatArray) -> FloatArray:
        """As `Rows` has it; a lens shifts the place where a shaft is seen."""
        place = D[:, 0].copy()
        if EYES[0] in self._of_eye:
            per_pixel = shafts.p_V[:, 0, 2] / self.focal
            place[:, :2, self._of_eye[EYES[0]]] = per_pixel[:, None, None] * np.eye(2)
        s_V = shafts.p_V[:, 1] - shafts.p_V[:, 0]
        s_V /= np.linalg.norm(s_V, axis=1)[:, None]
        return np.asarray(place - s_V[:, :, None] * np.einsum("ns,nsp->np", s_V, place)[:, None])


def _whole(points: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether all of (N, 2, 2) are numbers."""
    return np.asarray(np.isfinite(points).all(axis=(1, 2)))


def _before_the_eye(u: FloatArray, z: FloatArray, dz: FloatArray) -> FloatArray:
    """Numbers (n, k) of points at the depth z + u dz, of lines (n, 1), so that none is too near."""
    deepest = NEAREST * np.minimum(z, z + dz)
    nearest = (deepest - z) / np.where(dz == 0.0, 1e-12, dz)
    kept = np.where(dz < 0.0, np.minimum(u, nearest), np.maximum(u, nearest))
    return np.clip(np.where(np.isnan(kept), 0.5, kept), -FARTHEST, 1.0 + FARTHEST)
