"""Watches whether instruments are seen where their joints put them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from surg_core import ConfigError, inverse_pose
from surg_core.config import Cell
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_core.lens_file import Lens
from surg_core.transforms import FloatArray
from surg_perception.calibration.tip_finder import Mask, NotSeen
from surg_perception.depth.rectification import Picture
from surg_perception.drift.drift_evidence import DriftEvidence
from surg_perception.drift.drift_verdict import STILL_LIKELY, Verdict
from surg_perception.drift.moving_parts import Part
from surg_perception.drift.seen_shafts import SeenShaft, ShaftRows, stacked
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
EARLIER = 0.1
"""[s] Joints are taken so long before a picture besides, for the acceleration: pictures may lag."""
LOST = 10.0
"""[s] Without a sighting for so long while an instrument moves, nobody can tell any more."""
RADIUS = 0.003
"""[m] Of a shaft that no capsule states."""

Joints = Callable[[str, float], FloatArray | None]
"""Joints (n,) of an arm [rad] at a time [s]; None: not known."""


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
        take: Callable[[SeenShaft], Verdict | None] | None = None,
        step: float | None = None,
    ) -> None:
        held = held_endoscope(cell)
        if held is None:
            raise ConfigError(
                f"{cell.config.file}: no arm holds the endoscope, so nothing says where it looks"
            )
        self.held: HeldEndoscope = held
        self._arms = {name: arm for name, arm in cell.arms.items() if name != held.arm}
        origins = {name: np.asarray(arm.X_WB)[:3, 3] for name, arm in cell.arms.items()}
        self.rows = ShaftRows(parts, held.arm, origins, lenses, held.X_LR)
        """What a sighting says of the steps of all parts."""
        self._newest: dict[str, SeenShaft] = {}
        self._widths: dict[str, list[float]] = {}
        self._take = take or DriftEvidence(parts, self.rows).add
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
        found = [self._see(name, seen) for name in moving]
        if any(found):
            self._seen_at = stamp
            return True
        if self.verdict is not None and self.verdict.nothing > STILL_LIKELY:
            self.verdict = self.verdict if stamp - self._seen_at < LOST else None
        return False

    def axes(self, eye: int) -> list[tuple[FloatArray, FloatArray]]:
        """Pixels (n, 2) of each shaft when last looked at: by the joints, and by the verdict."""
        found, view = [], self.rows.eyes[eye]
        for shaft in self._newest.values():
            pixels = view.pixels(between(shaft.p_V))
            moved = pixels.copy()
            if self.verdict is not None:
                ends = self.rows.moved(stacked([shaft]), self.verdict.x)[0]
                moved = view.pixels(between(ends)) + self.rows.of_lens(eye, self.verdict.x)
            found.append((pixels, moved))
        return found

    def _shaft(self, name: str, joints: Joints, stamp: float) -> SeenShaft | None:
        arm = self._arms[name]
        q, q_scope = joints(arm.name, stamp), joints(self.held.arm, stamp)
        if q is None or q_scope is None:
            return None
        X_WF = np.asarray(arm.X_WB @ np.asarray(arm.chain.forward(q)))
        X_VW = inverse_pose(self.held.poses(q_scope[None])[0])
        p_TipP_F = np.outer(SHAFT, -np.asarray(arm.tool.s_F))
        p_W = (np.asarray(arm.tool.p_FTip) + p_TipP_F) @ X_WF[:3, :3].T + X_WF[:3, 3]
        p_V = p_W @ X_VW[:3, :3].T + X_VW[:3, 3]
        return SeenShaft(
            stamp=stamp,
            arm=name,
            p_V=p_V,
            v_V=np.zeros_like(p_V),
            a_V=np.zeros_like(p_V),
            p_W=p_W,
            p_TipP_F=p_TipP_F,
            R_VW=X_VW[:3, :3],
            R_WF=X_WF[:3, :3],
            pixels=np.full((2, 2, 2), np.nan),
            sd=np.ones(2),
        )

    def _moved(self, name: str, stamp: float, joints: Joints) -> bool:
        """Whether an instrument has moved enough for another sighting; keeps where it is."""
        last = self._newest.get(name)
        if last is not None and 0.0 <= stamp - last.stamp < PAUSE:
            return False
        now = self._shaft(name, joints, stamp)
        if now is None:
            return False
        if last is not None and np.linalg.norm(now.p_V - last.p_V, axis=1).max() < self._step:
            return False
        steps = (-EARLIER, -MOMENT, MOMENT)
        earlier, past, future = (self._shaft(name, joints, stamp + step) for step in steps)
        if past is None or future is None:
            return False
        now = now._replace(v_V=(future.p_V - past.p_V) / (2.0 * MOMENT))
        if earlier is not None:  # a recording may begin with its first picture
            a_V = 2.0 * (earlier.p_V - now.p_V + EARLIER * now.v_V) / EARLIER**2
            now = now._replace(a_V=a_V)
        self._newest[name] = now
        return True

    def _see(self, name: str, greys: Sequence[tuple[Grey, Mask]]) -> bool:
        """Whether one instrument is seen in either eye; takes in what that says."""
        shaft = self._newest[name]
        p_V, seen_any = between(shaft.p_V), False
        half = self.rows.focal * self._radius(name) / p_V[:, 2]
        for eye, (grey, lit) in enumerate(greys):
            view = self.rows.eyes[eye]
            pixels = view.pixels(p_V)
            try:
                seen = find_shaft(grey, lit, pixels, half)
            except NotSeen as why:
                self.unseen[str(why)] += 1
                continue
            if not self._as_wide_as_ever(name, seen.width):
                self.unseen["a shaft of another width is seen"] += 1
                continue
            at = np.round(seen.at).astype(int)
            beside = pixels[at] + seen.offsets[:, None] * seen.normals
            if not np.isfinite(view.plane_of(beside)).all():
                self.unseen["a shaft is seen where the lens was not measured"] += 1
                continue
            shaft.pixels[eye], shaft.sd[eye], seen_any = beside, seen.sd, True
        if seen_any:
            self.verdict = self._take(shaft)
        return seen_any

    def _as_wide_as_ever(self, arm: str, width: float) -> bool:
        """Whether a width is that of this shaft: a streak of light along it is narrower."""
        widths = self._widths.setdefault(arm, [])
        widths.append(width)
        return abs(width / float(np.median(widths)) - 1.0) < WIDER

    def _radius(self, name: str) -> float:
        capsules = self._arms[name].instrument.capsules
        return next((float(each.radius) for each in capsules if each.name == "shaft"), RADIUS)


def between(ends: FloatArray) -> FloatArray:
    """(n, 3) points from one of the ends (2, 3) to the other."""
    return np.asarray(np.linspace(ends[0], ends[1], POINTS))
