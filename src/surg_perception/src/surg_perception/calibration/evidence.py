"""What a result must show before it is written: the limits of each step, and why it is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.calibration.bases import SeenBase
from surg_perception.calibration.handeye import HandEyeFit
from surg_perception.calibration.intrinsics import LensFit, SeenCorners
from surg_perception.calibration.stereo import StereoFit

LEAST_VIEWS = 12
LARGEST_HELD_OUT = 0.5
"""[px] rms of views that were not fitted."""
LEAST_COVERAGE = 0.9
"""Share of the half height that corners must reach in each quarter of the picture."""
LARGEST_ROWS = 0.5
"""[px] rms difference of rectified rows."""
LARGEST_IN_SPACE = 0.002
"""[m] 95th percentile of the error of triangulated corners."""
BASELINES = (0.0005, 0.05)
"""[m]"""

LEAST_POSTURES = 10
LEAST_TURN = np.radians(20.0)
"""[rad] Of the flange between two postures, about each of two axes."""
LARGEST_RMS = 1.0
"""[px]"""
LARGEST_SHIFT, LARGEST_TILT = 0.001, np.radians(0.5)
"""[m], [rad] Largest expected error of the hand-eye pose."""
LEAST_TOUCHES, LEAST_RESTS = 6, 8
LEAST_PATCH = 0.004
"""[m] rms extent of the touched corners along the shorter side of the board."""
TOUCH_TURN, TOUCH_SHIFT = np.radians(0.2) / 2.5, 0.0005 / 2.5
"""[rad], [m] Largest expected error of a base by touch: 0.2 degrees and 0.5 mm at 2.5 sigma."""
LEAST_SPREAD = 0.030
"""[m] Between the places of the tip that lie farthest apart."""
LARGEST_MISFIT, MISFIT_SIGMAS = 0.0025, 4.0
"""Share by which focal length or board size may seem wrong, unless within so many sigma."""


class Refused(ValueError):
    """The evidence does not suffice.

    Attributes:
        reasons: ``name: value; allowed; what to do`` of each limit that is not met.
    """

    def __init__(self, what: str, reasons: Sequence[str]) -> None:
        """State the result that is refused, and why."""
        super().__init__(f"{what} refused: " + "; ".join(reasons))
        self.reasons = tuple(reasons)


def coverage(seen: Sequence[SeenCorners], size: tuple[int, int]) -> FloatArray:
    """How far corners reach in each quarter of the picture (4,), as a share of the half height.

    The quarters are upper left, upper right, lower left, lower right.
    """
    pixels = np.concatenate([each.pixels for each in seen]) - (np.array(size) - 1.0) / 2.0
    quarter = (pixels[:, 0] > 0) + 2 * (pixels[:, 1] > 0)
    out = np.linalg.norm(pixels, axis=1) / (min(size) / 2.0)
    return np.array([out[quarter == k].max(initial=0.0) for k in range(4)])


def _lens_reasons(views: int, held_out: float) -> list[str]:
    """Why there are too few views, or views that do not agree."""
    reasons = []
    if views < LEAST_VIEWS:
        reasons.append(f"views: {views}; at least {LEAST_VIEWS}: take more")
    if not held_out <= LARGEST_HELD_OUT:
        reasons.append(
            f"held-out error: {held_out:.2f} px; at most {LARGEST_HELD_OUT:g}: the board is bent, "
            "moved during exposure or is not the stated one"
        )
    return reasons


def _coverage_reasons(seen: Sequence[SeenCorners], size: tuple[int, int], eye: str) -> list[str]:
    """Which corner of an eye's picture the board must still be shown in."""
    reached = coverage(seen, size)
    if reached.min() >= LEAST_COVERAGE:
        return []
    corner = ("upper left", "upper right", "lower left", "lower right")[reached.argmin()]
    return [
        f"coverage of the {eye} picture: {reached.min():.2f}; at least {LEAST_COVERAGE:g} of the "
        f"half height: show the board in the {corner} too"
    ]


def check_lens(result: LensFit, size: tuple[int, int]) -> None:
    """Raise `Refused` for the lens of a single eye without enough evidence."""
    seen = result.fit.solution.seen
    reasons = _lens_reasons(len(seen), result.held_out) + _coverage_reasons(seen, size, "left")
    if reasons:
        raise Refused("camera", reasons)


def check_stereo(result: StereoFit, size: tuple[int, int]) -> None:
    """Raise `Refused` for a pair of lenses without enough evidence."""
    seen = result.fit.solution.seen
    reasons = _lens_reasons(len(seen), result.held_out)
    for eye, name in enumerate(("left", "right")):
        reasons += _coverage_reasons([view[eye] for view in seen], size, name)
    x = float(result.stereo.X_LR[0, 3])
    if not BASELINES[0] <= x <= BASELINES[1]:
        why = "the eyes are swapped" if x < 0 else "is the size of the squares right?"
        reasons.append(f"baseline: {1e3 * x:.2f} mm; 0.5 to 50 mm: {why}")
    if not result.rows <= LARGEST_ROWS:
        reasons.append(
            f"rows: {result.rows:.2f} px; at most {LARGEST_ROWS:g}: are both pictures of one time?"
        )
    p95 = float(np.percentile(result.errors, 95))
    if not p95 <= LARGEST_IN_SPACE:
        reasons.append(
            f"error in space (95 %): {1e3 * p95:.2f} mm; at most {1e3 * LARGEST_IN_SPACE:g}: "
            "take views that are nearer and sharper"
        )
    if reasons:
        raise Refused("stereo", reasons)


def check_handeye(result: HandEyeFit) -> None:
    """Raise `Refused` for a hand-eye pose without enough evidence."""
    reasons = []
    n = len(result.fit.residuals)
    if n < LEAST_POSTURES:
        reasons.append(f"views: {n}; at least {LEAST_POSTURES}: take more")
    if not result.turns.min() >= LEAST_TURN:
        first, second = np.degrees(result.turns)
        reasons.append(
            f"turns: {first:.0f} and {second:.0f} deg about two axes; at least 20: tilt the scope "
            "in more directions and roll it"
        )
    if not result.fit.rms <= LARGEST_RMS:
        of_views = [float(np.sqrt(2.0 * np.mean(r**2))) for r in result.fit.residuals]
        worst = int(np.argmax(of_views))
        reasons.append(
            f"rms: {result.fit.rms:.2f} px; at most {LARGEST_RMS:g}: the board or the arm moved "
            "during a view, or the joints are another arm's; the worst view is number "
            f"{worst + 1} of {n} ({of_views[worst]:.2f} px): delete its row"
        )
    turn, shift = result.pose_error
    if not (shift <= LARGEST_SHIFT and turn <= LARGEST_TILT):
        reasons.append(
            f"expected error: {1e3 * shift:.2f} mm, {np.degrees(turn):.2f} deg; at most 1 mm, "
            "0.5 deg: take more views from more directions"
        )
    cures = ("the lens files do not fit: repeat ./surg calibrate CELL stereo with this focus",
             "the squares are of another size: measure the ruler, board --measured MM")  # fmt: skip
    names = ("focal length", "board size")
    for name, factor, sd, cure in zip(names, result.factors, result.factors_sd, cures, strict=True):
        off = abs(float(np.log(factor)))
        if off > max(LARGEST_MISFIT, MISFIT_SIGMAS * float(sd)):
            reasons.append(f"{name}: {100 * (factor - 1):+.2f} % would fit better; {cure}")
    if reasons:
        raise Refused("handeye", reasons)


def check_touch(result: SeenBase) -> None:
    """Raise `Refused` for a base by touch without enough evidence."""
    reasons = []
    turn, shift = result.error
    if result.n < LEAST_TOUCHES:
        reasons.append(f"touches: {result.n}; at least {LEAST_TOUCHES}: touch more corners")
    if not result.spread[1] >= LEAST_PATCH:
        reasons.append(
            f"touches: {1e3 * result.spread[1]:.1f} mm (rms) across their longest direction; at "
            f"least {1e3 * LEAST_PATCH:g}: touch corners all over the board, and move the board"
        )
    if not (shift <= TOUCH_SHIFT and turn <= TOUCH_TURN):
        needed = result.points_for(TOUCH_TURN, TOUCH_SHIFT)
        cure = (
            "the camera alone errs more: repeat ./surg calibrate CELL handeye with more views"
            if needed is None or result.camera_share > 0.5
            else f"{needed} touches like these would do, or fewer that lie farther apart, also "
            "nearer and farther from the lens; is the tool calibrated?"
        )
        reasons.append(
            f"expected error: {1e3 * shift:.2f} mm, {np.degrees(turn):.3f} deg; at most "
            f"{1e3 * TOUCH_SHIFT:g} mm, {np.degrees(TOUCH_TURN):g} deg: {cure}"
        )
    if reasons:
        raise Refused("bases", reasons)


def check_tip(result: SeenBase, p_S: FloatArray) -> None:
    """Raise `Refused` for a turn by tip without enough evidence; p_S (n, 3): of the tip."""
    reasons = []
    if result.n < LEAST_RESTS:
        reasons.append(f"rests: {result.n}; at least {LEAST_RESTS}: take more")
    apart = float(np.linalg.norm(p_S[:, None] - p_S[None], axis=2).max())
    if not apart >= LEAST_SPREAD:
        reasons.append(
            f"rests: {1e3 * apart:.0f} mm apart at most; at least {1e3 * LEAST_SPREAD:g}: go to "
            "places all over the view"
        )
    turn = result.error[0]
    if not turn <= np.radians(2.0):
        reasons.append(
            f"expected error: {np.degrees(turn):.2f} deg; at most 2 deg: go to places farther "
            "apart, also nearer and farther from the lens"
        )
    if reasons:
        raise Refused("bases", reasons)
