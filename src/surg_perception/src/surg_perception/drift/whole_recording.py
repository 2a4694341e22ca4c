"""The step of a part that moved, from every sighting since then.

The watch judges the newest sightings; a correction has time for all of them. It looks again with
the part where it was last found, so that derivatives hold for a bump of any size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from surg_core import ConfigError, make_pose
from surg_core.config import Cell
from surg_core.held_endoscope import HeldEndoscope
from surg_core.lens_file import Lens
from surg_core.transforms import FloatArray, rotation_of
from surg_perception.calibration.small_motions import moved
from surg_perception.drift.drift_evidence import PRIOR
from surg_perception.drift.drift_watch import DriftWatch
from surg_perception.drift.moving_parts import CAMERA, Part
from surg_perception.drift.seen_shafts import Rows, SeenShaft, stacked

ASIDE, SLOPE = 0.4, 0.1
"""[px] One sigma of what a shaft is seen aside, and of half the difference between both its places,
beside its rows' scatter: shade and blur do not turn it."""
APART = 0.002
"""[m] Way of a shaft between two sightings: nearer ones are alike, and would count twice."""
OUTLIER, MISFIT = 3.0, 2.0
"""[sigma] Beyond this a residual counts less; largest typical one that is accepted."""
LOOKS = 4
"""Most often that a recording is looked at."""
SETTLED = 2e-5
"""[m] Another look is not needed once the last one shifted what is seen by less."""
SHIFT, TURN = 1.2e-4, np.radians(0.1)
"""[m], [rad] Expected error, one sigma, up to which a correction is written: that of a fresh
calibration (docs/results/perception.md)."""
LONGEST = 300.0
"""[s] Who would have to record longer must move more instead."""

Look = Callable[[DriftWatch], None]
"""Shows a watch all pictures since the motion."""


@dataclass(frozen=True)
class Found:
    """Where the part stands.

    Attributes:
        pose: (4, 4) of the camera in its flange, or of the base in the world.
        covariance: (6, 6) of its step, in the axes of `moving_parts`.
        sightings: How many there were.
    """

    pose: FloatArray
    covariance: FloatArray
    sightings: int


def find(
    cell: Cell, part: Part, lenses: Sequence[Lens], parts: Sequence[Part], look: Look
) -> Found:
    """The part's pose by every sighting.

    Raises:
        ConfigError: They do not agree, or say too little: with what to record.
    """
    held: HeldEndoscope | None = None
    for _ in range(LOOKS):
        sightings: list[SeenShaft] = []
        watch = DriftWatch(cell, lenses, parts, sightings.append, APART)
        watch.held = held = watch.held if held is None else replace(watch.held, X_FV=held.X_FV)
        look(watch)
        if len(sightings) < 2:
            raise ConfigError("nothing is seen since it moved. There is nothing to accept")
        rows = watch.rows.at(stacked(sightings), np.zeros(watch.rows.steps))
        fit = _fit(rows, part, parts)
        step = fit.x[part.at]
        if part.kind == CAMERA:
            assert held.X_FV is not None
            pose = held.X_FV @ make_pose(step[3:], rotation_of(step[:3]))
            held = replace(held, X_FV=pose)
        else:
            arm = cell.arms[part.of]
            pose = moved(arm.X_WB, step)
            cell = replace(cell, arms={**cell.arms, part.of: replace(arm, X_WB=pose)})
        if fit.shift < SETTLED:
            break
    _check(fit, part, rows, sightings)
    return Found(pose, fit.covariance[part.at, part.at], len(sightings))


@dataclass(frozen=True)
class _Fit:
    """One look.

    Attributes:
        x: (P,) steps of all parts.
        covariance: (P, P) of x.
        shift: How far the part's step shifts what is seen [m].
        misfit: Typical residual, in sigmas.
        rival: Another part that had to move besides.
        gain: How much likelier the residuals are if it did, logarithm.
    """

    x: FloatArray
    covariance: FloatArray
    shift: float
    misfit: float
    rival: str
    gain: float


def _fit(rows: Rows, part: Part, parts: Sequence[Part]) -> _Fit:
    """Least squares with the calibration as prior; outliers count less."""
    A, r, sd = _middle_and_slope(rows)
    prior = np.zeros((A.shape[1],) * 2)
    for each in parts:
        prior[each.at, each.at] = each.still + (each.moved if each is part else 0.0)
    weight, off = sd**-2, np.zeros(len(r))
    for sharp in (False,) * 10 + (True,) * 10:  # first convex, so that no outlier is the beginning
        information, pull = (A * weight[:, None]).T @ A, A.T @ (weight * r)
        evidence, x, covariance = _posterior(information, pull, prior)
        off = np.abs(r - A @ x) / sd
        less = (1.0 + (off / OUTLIER) ** 2) ** 2 if sharp else np.maximum(1.0, off)
        weight = sd**-2 / less
    gains = {}
    for each in parts:
        if each is not part:
            both = prior.copy()
            both[each.at, each.at] += each.moved
            gains[each.name] = _posterior(information, pull, both)[0] - evidence
    rival = max(gains, key=gains.__getitem__)
    shift = float(np.sqrt(np.mean(np.sum((rows.place[..., part.at] @ x[part.at]) ** 2, axis=1))))
    misfit = float(np.median(off)) / 0.6745  # a normal one's median
    return _Fit(x, covariance, shift, misfit, rival, gains[rival])


def _posterior(
    information: FloatArray, pull: FloatArray, prior: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Logarithm of the evidence up to a constant, mean (P,), covariance (P, P)."""
    half = np.linalg.cholesky(prior)
    S = np.eye(len(prior)) + half.T @ information @ half
    covariance = half @ np.linalg.solve(S, half.T)
    x = covariance @ pull
    return 0.5 * float(pull @ x - np.linalg.slogdet(S)[1]), x, covariance


def _middle_and_slope(rows: Rows) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (n, P), r (n,), sd (n,): middle and slope of each seen shaft.

    What both places of a shaft are off together leaves its slope as it is, which so tells a turn
    much better than a shift.
    """
    seen = rows.A.any(axis=2).reshape(-1, 2).all(axis=1)
    pairs, offsets = rows.A.reshape(len(seen), 2, -1)[seen], rows.r.reshape(-1, 2)[seen]
    sd = rows.sd.reshape(-1, 2)[seen, 0] / np.sqrt(2.0)
    half = 0.5 * np.array([[1.0], [-1.0]])
    return (
        np.concatenate([pairs.mean(axis=1), (half * pairs).sum(axis=1)]),
        np.concatenate([offsets.mean(axis=1), (offsets @ half)[:, 0]]),
        np.concatenate([np.hypot(sd, ASIDE), np.hypot(sd, SLOPE)]),
    )


def _check(fit: _Fit, part: Part, rows: Rows, sightings: Sequence[SeenShaft]) -> None:
    if fit.misfit > MISFIT:
        raise ConfigError(
            f"{part.name}: no single step explains all that was seen since (typical residual "
            f"{fit.misfit:.1f} sigma; allowed: {MISFIT:g}). Record anew with everything clamped"
        )
    if fit.gain > np.log(1.0 / PRIOR):
        raise ConfigError(
            f"{part.name} alone does not explain all that was seen since: {fit.rival} would. "
            "Turn the endoscope, and record anew"
        )
    C = fit.covariance
    spread = np.einsum("nij,jk,nik->n", rows.place, C, rows.place)
    shift = float(np.sqrt(np.mean(spread)))
    turn = float(np.sqrt(np.trace(C[part.at, part.at][:3, :3])))
    short = max(shift / SHIFT, turn / TURN)
    if short <= 1.0:
        return
    seconds = (sightings[-1].stamp - sightings[0].stamp) * short**2
    wanted = f"{10 * np.ceil(seconds / 10):.0f} s of" if seconds < LONGEST else "wider"
    raise ConfigError(
        f"{part.name}: {len(sightings)} sightings leave {1e3 * shift:.2f} mm and "
        f"{np.degrees(turn):.2f}° (allowed: {1e3 * SHIFT:g} mm, {np.degrees(TURN):.1f}°). Record "
        f"{wanted} motion: the tip all over the view, near and far, while the endoscope turns"
    )
