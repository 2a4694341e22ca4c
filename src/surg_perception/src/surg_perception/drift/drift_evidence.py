"""Which part of the chain moved, from what is seen beside the place where joints put it.

Each sighting gives residuals ``r = A x + e``: x has the steps of all parts. The calibration states
their covariance at first; older sightings narrow it. If one part moved since, its covariance is
large. All is linear and normal, so the probability of the newest residuals under each of these
hypotheses is a closed form (C. Bishop, "Pattern recognition and machine learning", 2006, section
3.5), and so is the estimate of x with its covariance. What nobody can tell apart, such as a moved
camera and a moved base while the endoscope rests, comes out with equal probabilities.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.drift.moving_parts import Part

NOTHING = "nothing"
PRIOR = 1e-3
"""Probability that something moved, before anything is seen; each part has an equal share."""
BIAS = 0.4
"""[px] One sigma of what a sighting's edges are off together: shade, blur, a bent shaft."""
WINDOWS = (8, 16, 32)
"""Newest sightings that are judged together: a part may have moved among older ones."""
STABLE = 0.1
"""What may change while nothing moves, as a share of the calibration's sigmas: warmth, bending."""
SCALES = (0.1, 0.3, 1.0)
"""How much of what it may a part moved by, each as probable: a bump is small or large."""
STILL_LIKELY = 0.5
"""Probability of no motion above which older sightings count as those of a chain at rest."""
UNLIKELY = 1e-3
"""Probability of a part's motion below which it does not count in what is expected."""
EXPLAINED = 2.0
"""[sigma] Typical residual up to which a part that moved explains what is seen."""
OUTLIER = 3.0
"""[sigma] Beyond this a residual of the freest hypothesis counts less: it is another shaft's."""


@dataclass(frozen=True)
class Sighting:
    """What one pair of pictures says of one instrument.

    Attributes:
        stamp: When [s].
        A: (m, P) derivatives of the residuals by all steps.
        r: (m,) residuals [px].
        sd: (m,) of their noise [px].
        place: (3, P) how far the shaft's end then lies beside the place that joints give it, across
            the shaft [m].
        away: How far it is before the eye [m].
    """

    stamp: float
    A: FloatArray
    r: FloatArray
    sd: FloatArray
    place: FloatArray
    away: float


@dataclass(frozen=True)
class Verdict:
    """Of one window of sightings.

    Attributes:
        probabilities: Of `NOTHING` and of each part's name; their sum is 1.
        odds: Logarithm of how much more probable the best part's motion is than none.
        best: The most probable part.
        x: (P,) steps of all parts, if the best one moved.
        covariance: (P, P) of x.
        beside: How far instruments are seen beside their place [m].
        beside_sd: One sigma of it [m].
        misfit: Typical residual that the best part leaves, in sigmas: about 1 if it explains all.
        since: Stamp of the first sighting that the motion explains better than rest does [s].
        sightings: How many there are.
    """

    probabilities: dict[str, float]
    odds: float
    best: Part
    x: FloatArray
    covariance: FloatArray
    beside: float
    beside_sd: float
    misfit: float
    since: float
    sightings: int

    @property
    def nothing(self) -> float:
        """Probability that nothing moved."""
        return self.probabilities[NOTHING]


class DriftEvidence:
    """Sightings in order, and what they say.

    Args:
        parts: All parts.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = list(parts)
        still = _covariance(self.parts)
        self._x, self._still = np.zeros(len(still)), still
        self._window: deque[Sighting] = deque()

    def add(self, sighting: Sighting) -> Verdict | None:
        """Take in the newest sighting.

        The oldest of a full window narrows what is known of a chain at rest, unless it moved: then
        what was known before stays the measure.

        Returns:
            Of the window whose evidence that something moved is strongest; None: too few.
        """
        self._window.append(sighting)
        newest = list(self._window)
        windows = [newest[-n:] for n in WINDOWS if n <= len(newest)]
        verdicts = [self._doubted(window) for window in windows]
        explained = [each for each in verdicts if each.misfit < EXPLAINED] or verdicts
        found = max(explained, key=lambda each: each.odds, default=None)
        if len(newest) == WINDOWS[-1]:
            old = self._window.popleft()
            if found is not None and found.nothing > STILL_LIKELY:
                self._narrow(old)
        return found

    def _narrow(self, old: Sighting) -> None:
        r = old.r - old.A @ self._x
        weight = _weights(old.A, r, np.hypot(old.sd, BIAS), self._free())
        information = (old.A * weight[:, None]).T @ old.A
        _, step, self._still = _posterior(information, old.A.T @ (weight * r), self._still)
        self._x = self._x + step

    def _doubted(self, window: Sequence[Sighting]) -> Verdict:
        """Of a window without the sighting that says most that something moved: it may be wrong."""
        found = self._verdict(window)
        if found.nothing > STILL_LIKELY:
            return found
        off = [np.max(np.abs(each.r - each.A @ self._x) / BIAS) for each in window]
        worst = int(np.argmax(off))
        rest = [each for k, each in enumerate(window) if k != worst]
        return min(found, self._verdict(rest), key=lambda each: each.odds)

    def _verdict(self, window: Sequence[Sighting]) -> Verdict:
        A = np.concatenate([each.A for each in window])
        r = np.concatenate([each.r for each in window]) - A @ self._x
        sd = np.hypot(np.concatenate([each.sd for each in window]), BIAS)
        weight = _weights(A, r, sd, self._free())
        information, pull = (A * weight[:, None]).T @ A, A.T @ (weight * r)
        still = self._still + _covariance(self.parts, STABLE)
        nothing, x, C = _posterior(information, pull, still)
        left, pulled = information - information @ C @ information, pull - information @ x
        gains = [_gains(left[part.at, part.at], pulled[part.at], part) for part in self.parts]
        prior = np.log(PRIOR / len(self.parts)) - np.log(len(SCALES))
        by_scale = nothing + prior + np.array(gains)
        logs = np.array([nothing, *np.logaddexp.reduce(by_scale, axis=1)])
        p, by_scale = np.exp(logs - logs.max()), np.exp(by_scale - logs.max())
        names = (NOTHING, *(part.name for part in self.parts))
        probabilities = dict(zip(names, (p / p.sum()).tolist(), strict=True))

        def moved_by(number: int, scale: int) -> tuple[FloatArray, FloatArray]:
            P = _with(still, self.parts[number], SCALES[scale])
            return _posterior(information, pull, P)[1:]

        place = np.concatenate([each.place for each in window])
        away = float(np.mean([each.away for each in window]))
        shifts = [(p[0], *_beside(place, away, self._x + x, C))]
        for number, scale in np.argwhere(by_scale > UNLIKELY * p.sum()):
            x_part, C_part = moved_by(number, scale)
            shift = _beside(place, away, self._x + x_part, C_part)
            shifts.append((by_scale[number, scale], *shift))
        most = int(np.argmax(p[1:]))
        best = self.parts[most]
        x, covariance = moved_by(most, int(np.argmax(by_scale[most])))
        misfit = float(np.median(np.abs(r - A @ x) / sd)) / 0.6745  # a normal one's median
        since = _since(window, weight * (r**2 - (r - A @ x) ** 2))
        x = self._x + x
        beside, beside_sd = _averaged(shifts)
        odds, count = float(logs[1:].max() - logs[0]), len(window)
        return Verdict(
            probabilities, odds, best, x, covariance, beside, beside_sd, misfit, since, count
        )

    def _free(self) -> FloatArray:
        """(P, P) covariance if everything moved."""
        free = self._still
        for part in self.parts:
            free = _with(free, part, 1.0)
        return free


def _averaged(shifts: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Mean and one sigma over hypotheses, of each one's probability, mean and sigma."""
    p, mean, sd = np.array(shifts).T
    p = p / p.sum()
    middle = float(p @ mean)
    return middle, float(np.sqrt(p @ (sd**2 + (mean - middle) ** 2)))


def _since(window: Sequence[Sighting], gain: FloatArray) -> float:
    """When it moved: motion gains most over rest from there on, by each residual's gain (m,)."""
    first = np.cumsum([0, *(len(each.r) for each in window[:-1])])
    after = np.cumsum(np.add.reduceat(gain, first)[::-1])[::-1]
    return window[int(np.argmax(after))].stamp


def _beside(
    place: FloatArray, away: float, x: FloatArray, covariance: FloatArray
) -> tuple[float, float]:
    """Root mean square of the shifts (3n, P) x of n places [m], and one sigma of it.

    Derivatives leave out what is of second order: turned by an angle a, a place `away` [m] from the
    eye shifts by away a, and by away a^2 / 2 more.
    """
    shift, n = place @ x, len(place) / 3.0
    rms = float(np.sqrt(shift @ shift / n))
    slope = place.T @ shift / (n * max(rms, 1e-12))
    second = rms**2 / (2.0 * away)
    return rms, float(np.sqrt(slope @ covariance @ slope + second**2))


def _covariance(parts: Sequence[Part], share: float = 1.0) -> FloatArray:
    """(P, P) covariance of all steps while nothing moved, or a share of their sigmas."""
    P = np.zeros((parts[-1].at.stop,) * 2)
    for part in parts:
        P[part.at, part.at] = share**2 * part.still
    return P


def _with(still: FloatArray, part: Part, scale: float) -> FloatArray:
    """(P, P) covariance of all steps if one part moved by so much of what it may."""
    moved = still.copy()
    moved[part.at, part.at] += scale**2 * part.moved
    return moved


def _gains(left: FloatArray, pulled: FloatArray, part: Part) -> list[float]:
    """How much likelier the residuals become if one part moved, by `SCALES`; logarithms.

    Args:
        left: (k, k) information on the part's steps that a chain at rest leaves.
        pulled: (k,) what it leaves of the pull on them.
        part: The part.
    """
    found = []
    for scale in SCALES:
        half = scale * np.sqrt(part.moved)  # diagonal
        S, b = np.eye(len(half)) + half @ left @ half, half @ pulled
        found.append(0.5 * float(b @ np.linalg.solve(S, b) - np.linalg.slogdet(S)[1]))
    return found


def _posterior(
    information: FloatArray, pull: FloatArray, prior: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Logarithm of the evidence up to a constant, mean (P,), covariance (P, P)."""
    half = np.linalg.cholesky(prior + 1e-24 * np.eye(len(prior)))
    S = np.eye(len(prior)) + half.T @ information @ half
    covariance = half @ np.linalg.solve(S, half.T)
    x = covariance @ pull
    return 0.5 * float(pull @ x - np.linalg.slogdet(S)[1]), x, covariance


def _weights(A: FloatArray, r: FloatArray, sd: FloatArray, prior: FloatArray) -> FloatArray:
    """Weights (m,) [1/px^2]; outliers of the freest hypothesis have less.

    The same weights serve all hypotheses, else one that fits nothing would have the fewest
    residuals to explain.
    """
    weight = sd**-2
    for _ in range(5):
        _, x, _ = _posterior((A * weight[:, None]).T @ A, A.T @ (weight * r), prior)
        off = np.abs(r - A @ x) / sd
        weight = sd**-2 / (1.0 + (off / OUTLIER) ** 2) ** 2  # Geman and McClure, 1987
    return weight
