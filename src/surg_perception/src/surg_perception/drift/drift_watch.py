"""Watches whether instruments are seen where their joints put them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from surg_core import ConfigError, inverse_pose
from surg_core.config import Cell
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_core.lens_file import Lens
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.transforms import FloatArray
from surg_perception.calibration.tip_finder import Mask, NotSeen
from surg_perception.depth.rectification import Picture
from surg_perception.drift.drift_evidence import (
    STILL_LIKELY,
    DriftEvidence,
    Sighting,
    Verdict,
)
from surg_perception.drift.moving_parts import EYES, LENS, Part, SeenPoint, derivatives
from surg_perception.drift.shaft_axis import ShaftAxis
from surg_perception.drift.shaft_finder import Grey, find_shaft, lit_part

SHAFT = (0.022, 0.07)
"""[m] Part of the shaft that is looked for, up from the tip: behind the jaws."""
POINTS = 40
"""Points of it: rows of the unrolled picture."""
STEP = 0.001
"""[m] Way of the shaft before the eye between two sightings: a resting one says nothing new."""
PAUSE = 0.1
"""[s] Least time between two sightings of one instrument; bounds the cost."""
THINNED = 8
"""Every so many pixels are compared: equal ones show a picture that stands still."""
WIDER = 0.15
"""A shaft is at most so much wider or narrower than it mostly was, relative."""
MOMENT = 0.005
"""[s] Joints are taken so long before and behind a picture, for the speed."""
NEAREST = 0.5
"""Least depth, relative, of a shaft half way through its steps; nearer, derivatives explode."""
LOST = 10.0
"""[s] Without a sighting for so long while an instrument moves, nobody can tell any more."""
RADIUS = 0.003
"""[m] Of a shaft that no capsule states."""

Joints = Callable[[str, float], FloatArray | None]
"""Joints (n,) of an arm [rad] at a time [s]; None: not known."""


_Line = tuple[int, tuple[int, int], FloatArray]
"""Eye, numbers of two points of the shaft, and the pixels (2, 2) of its seen axis beside them."""


class DriftWatch:
    """The chain of one cell.

    Args:
        cell: As everybody but the simulator believes it.
        lenses: Of the left eye, or of both, for the pictures' size.
        parts: As `stated_parts.stated_parts` reads them.
        take: Takes in each sighting, and judges; None: as `DriftEvidence` does.
        step: Way of a shaft between two sightings of it [m].

    Raises:
        ConfigError: No arm holds the endoscope.
    """

    def __init__(
        self,
        cell: Cell,
        lenses: Sequence[Lens],
        parts: Sequence[Part],
        take: Callable[[Sighting], Verdict | None] | None = None,
        step: float | None = None,
    ) -> None:
        held = held_endoscope(cell)
        if held is None:
            raise ConfigError(
                f"{cell.config.file}: no arm holds the endoscope, so nothing says where it looks"
            )
        self.held: HeldEndoscope = held
        self.parts = list(parts)
        self._arms = {name: arm for name, arm in cell.arms.items() if name != held.arm}
        self._origins = {name: np.asarray(arm.X_WB)[:3, 3] for name, arm in cell.arms.items()}
        poses = [np.eye(4)] if held.X_LR is None else [np.eye(4), held.X_LR]
        self._eyes = [EyeProjection(lens, X) for lens, X in zip(lenses, poses, strict=False)]
        self._focal = float(lenses[0].K[0, 0])
        self._last: dict[str, tuple[float, FloatArray]] = {}
        self._newest: dict[str, ShaftAxis] = {}
        self._widths: dict[str, list[float]] = {}
        self._take = take or DriftEvidence(self.parts).add
        self._step = STEP if step is None else step
        self._before: list[Picture] | None = None
        self._seen_at = 0.0
        self.unseen: Counter[str] = Counter()
        """Why shafts were not found, and how often."""
        self.verdict: Verdict | None = None
        """What moved, by the newest sightings; None: there are too few."""

    def look(self, stamp: float, pictures: Sequence[Picture], joints: Joints) -> bool:
        """Take in the pictures (h, w, 3) of one moment [s]; returns whether they said something."""
        q_scope = joints(self.held.arm, stamp)
        if q_scope is None:
            self.unseen[f"no joints of {self.held.arm} at the pictures' time"] += 1
            return False
        small = [picture[::THINNED, ::THINNED].copy() for picture in pictures]
        before, self._before = self._before, small
        still = before is not None and all(map(np.array_equal, before, small))
        moving = [name for name in self._arms if self._moved(name, stamp, joints)]
        if still and moving:
            self.unseen["the pictures stand still while joints move"] += 1
        if still or not moving:
            return False
        greys = [cv2.cvtColor(each, cv2.COLOR_RGB2GRAY).astype(np.float32) for each in pictures]
        seen = [(grey, lit_part(grey)) for grey in greys]
        found = [self._see(name, stamp, seen) for name in moving]
        if any(found):
            self._seen_at = stamp
            return True
        if self.verdict is not None and self.verdict.nothing > STILL_LIKELY:
            self.verdict = self.verdict if stamp - self._seen_at < LOST else None
        return False

    def axes(self, eye: int) -> list[tuple[FloatArray, FloatArray]]:
        """Pixels (n, 2) of each shaft when last looked at: by the joints, and by the verdict."""
        found, projection = [], self._eyes[eye]
        for axis in self._newest.values():
            pixels = projection.pixels(axis.p_V)
            moved = pixels.copy()
            if self.verdict is not None:
                for at in range(POINTS):
                    moved[at] += self._derivatives(axis, eye, at) @ self.verdict.x
            found.append((pixels, moved))
        return found

    def _axis(self, name: str, joints: Joints, stamp: float) -> ShaftAxis | None:
        arm = self._arms[name]
        q, q_scope = joints(arm.name, stamp), joints(self.held.arm, stamp)
        if q is None or q_scope is None:
            return None
        X_WF = np.asarray(arm.X_WB @ np.asarray(arm.chain.forward(q)))
        X_VW = inverse_pose(self.held.poses(q_scope[None])[0])
        up = np.linspace(*SHAFT, POINTS)[:, None]
        p_F = np.asarray(arm.tool.p_FTip) - up * np.asarray(arm.tool.s_F)
        p_W = p_F @ X_WF[:3, :3].T + X_WF[:3, 3]
        p_V = p_W @ X_VW[:3, :3].T + X_VW[:3, 3]
        p_TipP_F: FloatArray = p_F - np.asarray(arm.tool.p_FTip)
        rest = np.zeros_like(p_V)
        return ShaftAxis(name, p_TipP_F, p_W, p_V, X_WF[:3, :3], X_VW[:3, :3], rest)

    def _moved(self, name: str, stamp: float, joints: Joints) -> bool:
        """Whether an instrument has moved enough for another sighting; keeps where it is."""
        last = self._last.get(name)
        if last is not None and 0.0 <= stamp - last[0] < PAUSE:
            return False
        now = self._axis(name, joints, stamp)
        if now is None:
            return False
        ends = now.p_V[[0, -1]]
        if last is not None and np.linalg.norm(ends - last[1], axis=1).max() < self._step:
            return False
        past, future = (self._axis(name, joints, stamp + step) for step in (-MOMENT, MOMENT))
        if past is None or future is None:
            return False
        self._last[name] = stamp, ends
        self._newest[name] = replace(now, v_V=(future.p_V - past.p_V) / (2.0 * MOMENT))
        return True

    def _see(self, name: str, stamp: float, greys: Sequence[tuple[Grey, Mask]]) -> bool:
        """Whether one instrument is seen in either eye; takes in what that says."""
        axis = self._newest[name]
        half = self._focal * self._radius(name) / axis.p_V[:, 2]
        lines: list[_Line] = []
        noise: list[float] = []
        for eye, (grey, lit) in enumerate(greys):
            pixels = self._eyes[eye].pixels(axis.p_V)
            try:
                seen = find_shaft(grey, lit, pixels, half)
            except NotSeen as why:
                self.unseen[str(why)] += 1
                continue
            if not self._as_wide_as_ever(axis.arm, seen.width):
                self.unseen["a shaft of another width is seen"] += 1
                continue
            first, last = np.round(seen.at).astype(int)
            beside = pixels[[first, last]] + seen.offsets[:, None] * seen.normals
            if not np.isfinite(self._eyes[eye].plane_of(beside)).all():
                self.unseen["a shaft is seen where the lens was not measured"] += 1
                continue
            lines.append((eye, (int(first), int(last)), beside))
            noise.extend([seen.sd] * 2)
        if lines:
            known = self.verdict is not None and self.verdict.nothing < STILL_LIKELY
            x = self.verdict.x if self.verdict is not None and known else None
            self.verdict = self._take(self._sighting(stamp, axis, lines, np.array(noise), x))
        return bool(lines)

    def _sighting(
        self,
        stamp: float,
        axis: ShaftAxis,
        lines: Sequence[_Line],
        sd: FloatArray,
        x: FloatArray | None,
    ) -> Sighting:
        """With derivatives half way to where the steps x (P,) put the shaft, and exact residuals.

        Residuals are those of points from the seen line, in the plane that shows a straight shaft
        straight: a point may have slid along a line that the lens bends.
        """
        again = partial(self._sighting, stamp, axis, lines, sd)
        step = np.zeros(self.parts[-1].at.stop) if x is None else x
        between, moving = axis, self._without_lenses(step)
        if x is not None:
            points = {0, *(at for _, two, _ in lines for at in two)}
            between = self._half_way(axis, moving, points)
            if (between.p_V[:, 2] < NEAREST * axis.p_V[:, 2]).any():
                return again(None)  # no bump: what joints do not drive is fitted by any step
        A, r = [], []
        for eye, two, pixels in lines:
            lens = next(p.at for p in self.parts if p.kind == LENS and p.of == EYES[eye])
            first, last = self._eyes[eye].plane_of(pixels - step[lens])
            if not np.isfinite([first, last]).all():
                return again(None)
            n = np.array([first[1] - last[1], last[0] - first[0]])
            for at in two:
                n_pixel = n @ self._eyes[eye].plane_per_pixel(between.p_V[at])
                per_pixel = np.linalg.norm(n_pixel)  # noise is of the picture
                A.append(n_pixel / per_pixel @ self._derivatives(between, eye, at))
                way = self._derivatives(between, 0, at, metres=True) @ moving
                there = self._eyes[eye].plane((axis.p_V[at] + way)[None])[0]
                r.append(n @ (first - there) / per_pixel + A[-1] @ step)
        # Along the shaft nothing is seen: what it is beside its place is across.
        s_V = (axis.p_V[-1] - axis.p_V[0]) / np.linalg.norm(axis.p_V[-1] - axis.p_V[0])
        across = np.eye(3) - np.outer(s_V, s_V)
        place = across @ self._derivatives(between, 0, 0, metres=True)
        pixel = float(axis.p_V[0, 2] / self._focal)
        return Sighting(stamp, np.array(A), np.array(r), sd, place, pixel, again)

    def _without_lenses(self, x: FloatArray) -> FloatArray:
        """The steps (P,) that move the shaft before the eye."""
        moving = x.copy()
        for part in self.parts:
            moving[part.at] *= part.kind != LENS
        return moving

    def _half_way(self, axis: ShaftAxis, x: FloatArray, points: set[int]) -> ShaftAxis:
        """A shaft with these of its points half way to where the steps x (P,) put it."""
        half_V = np.zeros_like(axis.p_V)
        for at in points | {POINTS - 1}:
            half_V[at] = self._derivatives(axis, 0, at, metres=True) @ x / 2.0
        p_F = axis.p_TipP_F
        turned_V = (half_V[-1] - half_V[0]) / np.linalg.norm(p_F[-1] - p_F[0])
        turned_F = turned_V @ axis.R_VW @ axis.R_WF
        return replace(
            axis,
            p_V=axis.p_V + half_V,
            p_W=axis.p_W + half_V @ axis.R_VW,
            p_TipP_F=p_F + np.linalg.norm(p_F, axis=1)[:, None] * turned_F,
        )

    def _derivatives(self, axis: ShaftAxis, eye: int, at: int, metres: bool = False) -> FloatArray:
        """(2, P) of the pixel of one point of a shaft by all steps, or (3, P) of its place."""
        by_point = np.eye(3) if metres else self._eyes[eye].derivative(axis.p_V[at])
        point = SeenPoint(
            arm=axis.arm,
            eye=EYES[eye],
            p_V=axis.p_V[at],
            v_V=axis.v_V[at],
            p_W=axis.p_W[at],
            p_TipP_F=axis.p_TipP_F[at],
            R_VW=axis.R_VW,
            R_WF=axis.R_WF,
            by_point=by_point,
            per_pixel=axis.p_V[at, 2] / self._focal if metres else 1.0,
        )
        return derivatives(point, self.parts, self.held.arm, self._origins)

    def _as_wide_as_ever(self, arm: str, width: float) -> bool:
        """Whether a width is that of this shaft: a streak of light along it is narrower."""
        widths = self._widths.setdefault(arm, [])
        widths.append(width)
        return abs(width / float(np.median(widths)) - 1.0) < WIDER

    def _radius(self, name: str) -> float:
        capsules = self._arms[name].instrument.capsules
        return next((float(each.radius) for each in capsules if each.name == "shaft"), RADIUS)
