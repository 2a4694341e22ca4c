"""Best fits of many hypotheses to the same sightings, of which some may be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surg_core.transforms import FloatArray

WRONG = 6.0
"""Logarithm of how improbable a sighting becomes at worst; also where it begins to count less."""
SOFTENED = (256.0, 64.0, 16.0, 4.0, 1.0)
"""A fit begins with `WRONG` so many times as large, so that no wrong sighting leads it astray: H.
Yang et al., "Graduated non-convexity", IEEE RA-L 2020."""


class Sums(NamedTuple):
    """What N sightings say of P steps, in sigmas; a sighting of one eye has two empty rows of four.

    Attributes:
        A: (N, 4, P) derivatives of the residuals.
        r: (N, 4) residuals.
        information: (N, P P) derivatives by derivatives.
        pull: (N, P) derivatives by residuals.
    """

    A: FloatArray
    r: FloatArray
    information: FloatArray
    pull: FloatArray


@dataclass(frozen=True)
class Fits:
    """Best fits of H hypotheses.

    Attributes:
        x: (H, P) steps.
        covariance: (H, P, P) of them.
        log: (H,) logarithms of their evidence.
        chi: (H, N) squared residuals of all sightings.
    """

    x: FloatArray
    covariance: FloatArray
    log: FloatArray
    chi: FloatArray


def fits_of(sums: Sums, mask: FloatArray, mean: FloatArray, prior: FloatArray) -> Fits:
    """Fit H hypotheses.

    A sighting's cost is that of S. Geman and D. McClure, 1987, so that each hypothesis has
    outliers of its own and yet all can be compared.

    Args:
        sums: Of all sightings.
        mask: (H, N) 1 for those that a hypothesis is about, else 0.
        mean: (H, P) of the steps, before.
        prior: (H, P, P) covariance, before.
    """
    weight, shape, rows = mask, prior.shape, sums.A.reshape(-1, prior.shape[-1])
    for soft in (*SOFTENED, None):
        L = (weight @ sums.information).reshape(shape)
        v = weight @ sums.pull - (L @ mean[..., None])[..., 0]
        system = np.eye(shape[-1]) + prior @ L
        step = np.linalg.solve(system, prior @ v[..., None])[..., 0]
        x = mean + step
        off = (x @ rows.T).reshape(len(x), *sums.r.shape) - sums.r
        chi = np.einsum("hnr,hnr->hn", off, off)
        if soft is not None:
            weight = mask / (1.0 + chi / (2.0 * WRONG * soft)) ** 2
    cost = (mask * 0.5 * chi / (1.0 + chi / (2.0 * WRONG))).sum(axis=1)
    bent = np.sum(step * (v - (L @ step[..., None])[..., 0]), axis=1)
    log = -cost - 0.5 * bent - 0.5 * np.linalg.slogdet(system)[1]
    covariance = np.linalg.solve(system, prior)
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    return Fits(x, covariance, log, chi)


def foretold(sums: Sums, x: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N,) squared residuals of sightings by an earlier fit, in sigmas of both together.

    Args:
        sums: Of sightings that were not fitted.
        x: (P,) steps.
        covariance: (P, P) of them.
    """
    off = sums.A @ x - sums.r
    spread = sums.A @ covariance @ sums.A.transpose(0, 2, 1) + np.eye(off.shape[1])
    return np.einsum("nr,nr->n", off, np.linalg.solve(spread, off[..., None])[..., 0])


def joined(found: Sequence[Fits], times: int) -> Fits:
    """Fits of several kinds of hypotheses at each of the same times, as one: time by time."""

    def of(name: str) -> FloatArray:
        parts = [np.asarray(getattr(each, name)) for each in found]
        rows = [part.reshape(times, -1, *part.shape[1:]) for part in parts]
        return np.concatenate(rows, axis=1).reshape(-1, *parts[0].shape[1:])

    return Fits(of("x"), of("covariance"), of("log"), of("chi"))
