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
from collections.abc import Sequence

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.drift.drift_fits import Fits, Sums, fits_of, foretold, joined
from surg_perception.drift.drift_verdict import MISFIT, NOTHING, STILL_LIKELY, Verdict
from surg_perception.drift.moving_parts import LENS, TOOL, Part
from surg_perception.drift.seen_shafts import SeenShaft, ShaftRows, stacked
from surg_perception.drift.shaft_breath import BEND, ShaftBreath

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
"""A part may have moved so many sightings ago: before the first one, or after `NEWEST` of them."""
PERIOD = 0.5
"""[s] Least time between two judgements; bounds the cost, whatever the pictures' rate."""
SOONER = 0.3
"""[s] The same while a motion waits to be confirmed."""
STABLE = 0.3
"""What may change while nothing moves, as a share of the calibration's sigmas: warmth, bending."""
SCALES = (0.1, 0.3, 1.0)
"""How much of what it may a part moved by, each as probable: a bump is small or large."""
WILD = 10.0
"""Steps so many times as large as what a part may move by are no bump: its fit begins anew."""
NEWEST = LENGTHS[0]
"""Sightings for which it is stated how far instruments are beside their place."""
DRAWS = 200
"""Draws of the steps for its interval."""
UNLIKELY = 1e-3
"""Probability of a hypothesis below which it does not count there."""


class DriftEvidence:
    """Sightings in order, and what they say.

    Steps are counted here in units of what a part may move by.

    Args:
        parts: All parts.
        rows: What a sighting says of their steps.
    """

    def __init__(self, parts: Sequence[Part], rows: ShaftRows) -> None:
        self.parts, self._rows = list(parts), rows
        self._breath = ShaftBreath([part.at for part in self.parts if part.kind == TOOL])
        size = rows.steps + self._breath.size
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
        self._mean, self._none = np.zeros(size), np.zeros(rows.steps)
        self._kept: list[SeenShaft] = []
        empty = ((4, size), (4,), (size * size,), (size,))
        self._sums = Sums(*(np.zeros((0, *shape)) for shape in empty))
        self._variances = np.zeros(0)
        self._noise = BIAS**2 + ALIKE * BIAS**2
        self._at = np.zeros((len(self.parts), rows.steps))
        self._judged_at, self._new = -np.inf, 0
        self._verdict: Verdict | None = None
        self._foretelling = np.zeros(size), np.zeros((size, size))
        self._draws = np.random.default_rng(0).normal(size=(DRAWS, 3 * NEWEST + 1))

    def add(self, sighting: SeenShaft) -> Verdict | None:
        """Take in the newest sighting; returns the newest judgement, None: too few sightings."""
        self._kept.append(sighting)
        self._new += 1
        self._variances = np.append(self._variances, self._noise)
        told, _ = self._told(slice(-1, None), self._none)
        pairs = zip(self._sums, told, strict=True)
        self._sums = Sums(*(np.concatenate([old, new]) for old, new in pairs))
        since, last = abs(sighting.stamp - self._judged_at), self._verdict
        unsure = last is not None and last.moved and not last.confirmed
        if len(self._kept) >= LENGTHS[0] and since >= (SOONER if unsure else PERIOD):
            self._verdict, self._judged_at = self._judged(), sighting.stamp
            self._new = 0
            self._forget()
        return self._verdict

    def _told(self, kept: slice, x: FloatArray) -> tuple[Sums, FloatArray]:
        """What sightings say where the steps x (P,) put shafts, and all places (3 n, P)."""
        shafts, variances = stacked(self._kept[kept]), self._variances[kept]
        rows, n = self._rows.at(shafts, x), len(variances)
        sd = np.sqrt(rows.sd**2 + variances[:, None])
        A = self._derivatives(rows.A, shafts.stamp) / sd[..., None]
        r, columns = rows.r / sd, A.transpose(0, 2, 1)
        place = self._derivatives(rows.place, shafts.stamp).reshape(3 * n, -1)
        pull = (columns @ r[..., None])[..., 0]
        return Sums(A, r, (columns @ A).reshape(n, -1), pull), place

    def _derivatives(self, A: FloatArray, stamps: FloatArray) -> FloatArray:
        """(N, m, P) by all steps and bends, of those (N, m, k) by all steps in SI."""
        bends = self._breath.bends(A, stamps)
        return np.asarray(np.concatenate([A, bends], axis=2) * self._unit)

    def _breathe(self, x: FloatArray) -> None:
        """Take the rate of breathing from what is seen at rest, beside the steps x (P,)."""
        A = self._sums.A[:, :, : self._rows.steps]
        off = self._sums.r - A @ x[: self._rows.steps]
        stamps = np.array([each.stamp for each in self._kept])
        if self._breath.heard(A / self._unit[: self._rows.steps], off, stamps):
            self._sums, _ = self._told(slice(None), self._none)

    def _forget(self) -> None:
        """Let the oldest sightings go; of a chain at rest they narrow what is known of it."""
        old = len(self._kept) - LENGTHS[-1]
        if old < NEWEST:
            return
        assert self._verdict is not None
        if self._verdict.nothing >= STILL_LIKELY:
            mask = (np.arange(len(self._kept)) < old)[None].astype(float)
            fits = fits_of(self._sums, mask, self._mean[None], self._still[None])
            self._mean, self._still = fits.x[0], fits.covariance[0]
            steps = self._rows.steps
            self._mean[steps:] = self._still[steps:, :] = self._still[:, steps:] = 0.0
            self._still[steps:, steps:] = np.eye(len(self._mean) - steps)
        del self._kept[:old]
        self._sums = Sums(*(each[old:] for each in self._sums))
        self._variances = self._variances[old:]

    def _judged(self) -> Verdict:
        count, last = len(self._kept), self._verdict
        since = np.inf if last is None else last.since
        moved = sum(each.stamp >= since for each in self._kept)
        # Fewer sightings do not tell a chain at rest; forgotten ones came before those kept.
        longest = count if count >= LENGTHS[-1] else count - NEWEST
        told = {n for n in (*LENGTHS, moved) if NEWEST <= n <= longest or n == count}
        lengths = np.array(sorted(told or {count}))
        times, kinds = len(lengths), len(self._wander)
        before = (np.arange(count) < (count - lengths)[:, None]).astype(float)
        rest = fits_of(
            self._sums, before, np.tile(self._mean, (times, 1)), np.tile(self._still, (times, 1, 1))
        )
        fits, places = self._hypotheses(1.0 - before, rest)
        log = fits.log.reshape(times, kinds) + rest.log[:, None] - np.log(times)
        log[:, 1:] += self._prior
        p = np.exp(log - log.max())
        p /= p.sum()
        by_part = p[:, 1:].sum(axis=0).reshape(len(self.parts), -1).sum(axis=1)
        names = (NOTHING, *(part.name for part in self.parts))
        probabilities = dict(zip(names, (p[:, 0].sum(), *by_part), strict=True))
        likeliest = [_likeliest(log, number) for number in range(len(self.parts))]
        most, held = int(np.argmax(by_part)), int(np.argmax(p))
        best = likeliest[most]
        length = int(lengths[best // kinds])
        beside = self._beside(p.ravel(), fits, places)
        misfit = float(np.median(fits.chi[held, -lengths[held // kinds] :]))
        if probabilities[NOTHING] > STILL_LIKELY:
            self._listen(fits.chi[(times - 1) * kinds, -lengths[-1] :])
            self._breathe(fits.x[(times - 1) * kinds])
        explained = max(misfit, float(np.median(fits.chi[0, -NEWEST:]))) < MISFIT
        steady = probabilities[NOTHING] > STILL_LIKELY and explained
        at = fits.x[likeliest]
        at[np.abs(at).max(axis=1) > WILD] = 0.0
        self._at = (at * self._unit)[:, : self._rows.steps] * (not steady)
        confirmed = self._confirmed()
        self._foretelling = fits.x[best], fits.covariance[best]
        return Verdict(
            {name: float(value) for name, value in probabilities.items()},
            self.parts[most],
            (fits.x[best] * self._unit)[: self._rows.steps],
            beside,
            misfit,
            self._kept[-length].stamp,
            length,
            confirmed,
        )

    def _confirmed(self) -> bool:
        """Whether the motion that was judged before foretold what was seen since, now or earlier.

        What joints do not drive looks for some sightings as if a part had moved, then otherwise.
        """
        last = self._verdict
        if last is None or not last.moved:
            return False
        if last.confirmed:
            return True
        x, covariance = self._foretelling
        told, _ = self._told(slice(-self._new, None), (x * self._unit)[: self._rows.steps])
        return float(np.median(foretold(told, x, covariance))) < MISFIT

    def _hypotheses(self, mask: FloatArray, rest: Fits) -> tuple[Fits, list[FloatArray]]:
        """Fits of all kinds at each of T times, and for each kind the places of the newest.

        Each part's are made where its own steps by now put the shafts, so that they converge.

        Args:
            mask: (T, N) of the sightings since.
            rest: Of those before, at each time.
        """
        prior = rest.covariance[:, None] + self._wander
        _, place = self._told(slice(-NEWEST, None), self._none)
        groups = [(len(self._wander), self._sums, place)]
        if self._at.any():
            groups = [(1, self._sums, place)]
            for x in self._at:
                sums, place = self._told(slice(None), x)
                groups.append((len(SCALES), sums, place[-3 * NEWEST :]))
        found, places = list[Fits](), list[FloatArray]()
        for kinds, sums, place in groups:
            of, size = slice(len(places), len(places) + kinds), len(self._unit)
            means, priors = np.repeat(rest.x, kinds, axis=0), prior[:, of].reshape(-1, size, size)
            found.append(fits_of(sums, np.repeat(mask, kinds, axis=0), means, priors))
            places += [np.linalg.qr(place / np.sqrt(NEWEST))[1]] * kinds
        return joined(found, len(mask)), places

    def _listen(self, chi: FloatArray) -> None:
        """Take the noise of sightings from what the newest scatter by at rest (n,)."""
        rows = 2 * np.isfinite(stacked(self._kept[-len(chi) :]).pixels[:, :, 0, 0]).sum(axis=1)
        scatter = np.median(chi * self._variances[-len(chi) :] / rows) / 0.8  # of 2 or 4 rows
        self._noise = BIAS**2 + ALIKE * min(float(scatter), ROUGH**2)

    def _beside(
        self, p: FloatArray, fits: Fits, places: Sequence[FloatArray]
    ) -> tuple[float, float, float]:
        """Quantiles of the root mean square of the newest shifts, over all hypotheses [m]."""
        pixel = float(self._kept[-1].p_V[0, 2]) / self._rows.focal
        bias = np.sqrt(self._noise) * pixel * self._draws[:, -1]
        drawn, weights = [], []
        for number in np.flatnonzero(p > UNLIKELY):
            place = places[number % len(places)]
            spread, axes = np.linalg.eigh(place @ fits.covariance[number] @ place.T)
            half = axes * np.sqrt(np.maximum(spread, 0.0))
            shift = place @ fits.x[number] + self._draws[:, : len(half)] @ half.T
            drawn.append(np.abs(np.linalg.norm(shift, axis=1) + bias))
            weights.append(np.full(DRAWS, p[number]))
        values, weight = np.concatenate(drawn), np.concatenate(weights)
        order = np.argsort(values)
        held = np.cumsum(weight[order]) / weight.sum()
        low, middle, high = values[order][np.searchsorted(held, [0.025, 0.5, 0.975])]
        return float(low), float(middle), float(high)


def _likeliest(log: FloatArray, part: int) -> int:
    """Number of the likeliest hypothesis of a part, of log (T, kinds)."""
    of_part = np.full(log.shape, -np.inf)
    kinds = slice(1 + part * len(SCALES), 1 + (part + 1) * len(SCALES))
    of_part[:, kinds] = log[:, kinds]
    return int(np.argmax(of_part))
