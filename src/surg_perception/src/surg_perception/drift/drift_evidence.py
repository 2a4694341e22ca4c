"""Which part of the chain moved, and when, from what is seen beside the place where joints put it.

Each sighting gives residuals ``r = A x + e``: x has the steps of all parts, and how shafts bend
with the breath (`shaft_breath`). The calibration states the covariance of the steps at first;
sightings narrow it. If one part moved at some time, its covariance is
large from then on. A hypothesis is such a part with such a time; its probability takes in every
kept sighting, those before under rest and those since under the motion (C. Bishop, "Pattern
recognition and machine learning", 2006, section 3.5, at the best fit). A sighting that a hypothesis
does not explain costs it no more than `drift_fits.WRONG`: it may be of something else. What nobody
can tell apart, such as a moved camera and a moved base while the endoscope rests, comes out with
like probabilities.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.drift.drift_fits import Fits, Sums, fits_of
from surg_perception.drift.moving_parts import LENS, TOOL, Part
from surg_perception.drift.shaft_breath import BEND, ShaftBreath

NOTHING = "nothing"
PRIOR = 1e-3
"""Probability that something moved, before anything is seen; every kind has an equal share."""
BIAS = 0.5
"""[px] Least sigma of what a sighting is off beside its noise, and of what all of an eye's are off
together since a time: shade, blur, a bent shaft."""
ALIKE = 3.0
"""Variance beside it, of what sightings scatter by at rest: neighbours are alike in part."""
ROUGH = 1.5
"""[px] Largest scatter that is taken for noise."""
LENGTHS = (8, 16, 32, 64, 128)
"""A part may have moved so many sightings ago."""
PERIOD = 0.5
"""[s] Least time between two judgements; bounds the cost, whatever the pictures' rate."""
STABLE = 0.3
"""What may change while nothing moves, as a share of the calibration's sigmas: warmth, bending."""
SCALES = (0.1, 0.3, 1.0)
"""How much of what it may a part moved by, each as probable: a bump is small or large."""
NEWEST = LENGTHS[0]
"""Sightings for which it is stated how far instruments are beside their place."""
DRAWS = 200
"""Draws of the steps for its interval."""
CURVED = 0.05
"""One sigma of what derivatives leave out of a shift, as a share of it."""
UNLIKELY = 1e-3
"""Probability of a hypothesis below which it does not count there."""
STILL_LIKELY = 0.5
"""Probability of no motion above which the chain counts as one at rest."""


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
        pixel: What one pixel is there [m].
        again: The same with derivatives that hold for these steps (P,).
    """

    stamp: float
    A: FloatArray
    r: FloatArray
    sd: FloatArray
    place: FloatArray
    pixel: float
    again: Callable[[FloatArray], Sighting]


@dataclass(frozen=True)
class Verdict:
    """Of all kept sightings.

    Attributes:
        probabilities: Of `NOTHING` and of each part's name; their sum is 1.
        best: The most probable part.
        x: (P,) steps of all parts, if the best one moved.
        covariance: (P, P) of x.
        beside: How far the newest instruments are seen beside their place [m]: least, expected,
            largest, 95 %.
        misfit: Median squared residual of sightings since, by the best hypothesis [sigma^2].
        since: Stamp of the first sighting after the best part moved [s].
        sightings: How many there are since.
    """

    probabilities: dict[str, float]
    best: Part
    x: FloatArray
    covariance: FloatArray
    beside: tuple[float, float, float]
    misfit: float
    since: float
    sightings: int

    @property
    def nothing(self) -> float:
        """Probability that nothing moved."""
        return self.probabilities[NOTHING]


class DriftEvidence:
    """Sightings in order, and what they say.

    Steps are counted here in units of what a part may move by.

    Args:
        parts: All parts.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = list(parts)
        self._steps = parts[-1].at.stop
        self._breath = ShaftBreath([part.at for part in self.parts if part.kind == TOOL])
        size = self._steps + self._breath.size
        self._unit, still = np.full(size, BEND), BEND**2 * np.eye(size)
        shapes = []
        for part in self.parts:
            self._unit[part.at] = np.sqrt(np.diag(part.moved))
            still[part.at, part.at] = part.still
            shape = np.zeros((size, size))
            shape[part.at, part.at] = np.eye(part.at.stop - part.at.start)
            shapes += [scale**2 * shape for scale in SCALES]
        alike = Counter(part.kind for part in self.parts)
        shares = [alike[part.kind] for part in self.parts for _ in SCALES]
        self._prior = np.log(PRIOR / len(alike) / len(SCALES) / np.array(shares))
        self._still = still / np.outer(self._unit, self._unit)
        bias = np.zeros(size)
        for part in self.parts:
            bias[part.at] = BIAS**2 * (part.kind == LENS)
        self._wander = np.array([np.zeros((size, size)), *shapes])
        self._wander += STABLE**2 * self._still + np.diag(bias / self._unit**2)
        self._mean = np.zeros(size)
        self._kept: list[Sighting] = []
        empty = ((4, size), (4,), (size * size,), (size,))
        self._sums = Sums(*(np.zeros((0, *shape)) for shape in empty))
        self._variances = np.zeros(0)
        self._noise = BIAS**2 + ALIKE * BIAS**2
        self._judged_at, self._renewed = -np.inf, -1
        self._verdict: Verdict | None = None
        self._draws = np.random.default_rng(0).normal(size=(DRAWS, 3 * NEWEST + 2))

    def add(self, sighting: Sighting) -> Verdict | None:
        """Take in the newest sighting; returns the newest judgement, None: too few sightings."""
        self._kept.append(sighting)
        told = zip(self._sums, self._told(sighting), strict=True)
        self._sums = Sums(*(np.concatenate([old, new[None]]) for old, new in told))
        self._variances = np.append(self._variances, self._noise)
        since = abs(sighting.stamp - self._judged_at)
        if len(self._kept) >= LENGTHS[0] and since >= PERIOD:
            self._verdict, self._judged_at = self._judged(), sighting.stamp
            self._renew()
            self._forget()
        return self._verdict

    def _moved(self) -> bool:
        return self._verdict is not None and self._verdict.nothing < STILL_LIKELY

    def _told(self, sighting: Sighting) -> Sums:
        """Of one sighting."""
        sd = np.sqrt(sighting.sd**2 + self._noise)
        A, r = np.zeros((4, len(self._unit))), np.zeros(4)
        A[: len(sd)] = self._derivatives(sighting.A, sighting.stamp) / sd[:, None]
        r[: len(sd)] = sighting.r / sd
        return Sums(A, r, (A.T @ A).ravel(), A.T @ r)

    def _derivatives(self, A: FloatArray, stamp: float) -> FloatArray:
        """(m, P) by all steps and bends, of those (m, k) by all steps in SI."""
        return np.hstack([A, self._breath.bends(A, stamp)]) * self._unit

    def _breathe(self, x: FloatArray) -> None:
        """Take the rate of breathing from what is seen at rest, beside the steps x (P,)."""
        sums, steps = self._sums, self._steps
        off = sums.r - sums.A[:, :, :steps] @ x[:steps]
        stamps = np.array([each.stamp for each in self._kept])
        if self._breath.heard(sums.A[:, :, :steps] / self._unit[:steps], off, stamps):
            told = [self._told(each) for each in self._kept]
            self._sums = Sums(*(np.array(each) for each in zip(*told, strict=True)))

    def _renew(self) -> None:
        """Take some sightings since the motion again, where its steps by now put the shaft."""
        verdict, count = self._verdict, len(self._kept)
        assert verdict is not None
        if not self._moved():
            return
        for _ in range(NEWEST):
            following = (self._renewed + 1) % count
            self._renewed = max(following, count - verdict.sightings)
            self._kept[self._renewed] = self._kept[self._renewed].again(verdict.x)
            told = self._told(self._kept[self._renewed])
            for sums, each in zip(self._sums, told, strict=True):
                sums[self._renewed] = each

    def _forget(self) -> None:
        """Let the oldest sightings go; of a chain at rest they narrow what is known of it."""
        old = len(self._kept) - LENGTHS[-1]
        if old < NEWEST:
            return
        assert self._verdict is not None
        if not self._moved():
            mask = (np.arange(len(self._kept)) < old)[None].astype(float)
            fits = fits_of(self._sums, mask, self._mean[None], self._still[None])
            self._mean, self._still = fits.x[0], fits.covariance[0]
            steps = self._steps
            self._mean[steps:] = self._still[steps:, :] = self._still[:, steps:] = 0.0
            self._still[steps:, steps:] = np.eye(len(self._mean) - steps)
        del self._kept[:old]
        self._sums = Sums(*(each[old:] for each in self._sums))
        self._variances = self._variances[old:]

    def _judged(self) -> Verdict:
        count = len(self._kept)
        since = np.inf if self._verdict is None else self._verdict.since
        moved = sum(each.stamp >= since for each in self._kept)
        lengths = np.array(sorted({n for n in (*LENGTHS, moved) if LENGTHS[0] <= n <= count}))
        times, kinds, size = len(lengths), len(self._wander), len(self._unit)
        before = (np.arange(count) < (count - lengths)[:, None]).astype(float)
        rest = fits_of(
            self._sums, before, np.tile(self._mean, (times, 1)), np.tile(self._still, (times, 1, 1))
        )
        prior = rest.covariance[:, None] + self._wander
        fits = fits_of(
            self._sums,
            np.repeat(1.0 - before, kinds, axis=0),
            np.repeat(rest.x, kinds, axis=0),
            prior.reshape(-1, size, size),
        )
        log = fits.log.reshape(times, kinds) + rest.log[:, None] - np.log(times)
        log[:, 1:] += self._prior
        p = np.exp(log - log.max())
        p /= p.sum()
        by_part = p[:, 1:].sum(axis=0).reshape(len(self.parts), -1).sum(axis=1)
        names = (NOTHING, *(part.name for part in self.parts))
        probabilities = dict(zip(names, (p[:, 0].sum(), *by_part), strict=True))
        most = int(np.argmax(by_part))
        of_part = np.zeros(kinds, dtype=bool)
        of_part[1 + most * len(SCALES) : 1 + (most + 1) * len(SCALES)] = True
        best = int(np.argmax(np.where(of_part, p, -1.0)))
        held = int(np.argmax(p))
        length = int(lengths[best // kinds])
        beside = self._beside(p.ravel(), fits)
        if probabilities[NOTHING] > STILL_LIKELY:
            self._listen(fits.chi[(times - 1) * kinds, -lengths[-1] :])
            self._breathe(fits.x[(times - 1) * kinds])
        return Verdict(
            {name: float(value) for name, value in probabilities.items()},
            self.parts[most],
            (fits.x[best] * self._unit)[: self._steps],
            (fits.covariance[best] * np.outer(self._unit, self._unit))[
                : self._steps, : self._steps
            ],
            beside,
            float(np.median(fits.chi[held, -lengths[held // kinds] :])),
            self._kept[-length].stamp,
            length,
        )

    def _listen(self, chi: FloatArray) -> None:
        """Take the noise of sightings from what the newest scatter by at rest (n,)."""
        newest = self._kept[-len(chi) :]
        rows = np.array([len(each.r) for each in newest])
        scatter = np.median(chi * self._variances[-len(chi) :] / rows) / 0.8  # of 2 or 4 rows
        self._noise = BIAS**2 + ALIKE * min(float(scatter), ROUGH**2)

    def _beside(self, p: FloatArray, fits: Fits) -> tuple[float, float, float]:
        """Quantiles of the root mean square of the newest shifts, over all hypotheses [m]."""
        newest = self._kept[-NEWEST:]
        places = np.concatenate([self._derivatives(each.place, each.stamp) for each in newest])
        place: FloatArray = np.linalg.qr(places / np.sqrt(len(newest)))[1]
        bias = np.sqrt(self._noise) * newest[-1].pixel * self._draws[:, -1]
        curved = 1.0 + CURVED * self._draws[:, -2]
        drawn, weights = [], []
        for number in np.flatnonzero(p > UNLIKELY):
            spread, axes = np.linalg.eigh(place @ fits.covariance[number] @ place.T)
            half = axes * np.sqrt(np.maximum(spread, 0.0))
            shift = place @ fits.x[number] + self._draws[:, : len(half)] @ half.T
            rms = np.linalg.norm(shift, axis=1) * curved
            drawn.append(np.abs(rms + bias))
            weights.append(np.full(DRAWS, p[number]))
        values, weight = np.concatenate(drawn), np.concatenate(weights)
        order = np.argsort(values)
        held = np.cumsum(weight[order]) / weight.sum()
        low, middle, high = values[order][np.searchsorted(held, [0.025, 0.5, 0.975])]
        return float(low), float(middle), float(high)
