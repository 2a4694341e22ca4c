"""Whether a bend by the breath is heard, whatever its rate, and none where nothing breathes."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.perception.drift_recovery import drawn
from surg_perception.drift.shaft_breath import ShaftBreath

SIGHTINGS, SECONDS, SIGMAS = 60, 25.0, 5000.0
"""The last: what a pixel's sigmas change by one metre [1/m]."""


@pytest.mark.parametrize("rate", [0.0, 0.1934, 0.2551, 0.4117])
def test_the_rate_of_a_bend_is_heard(rate: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        stamps = 100.0 + np.sort(rng.uniform(0.0, SECONDS, SIGHTINGS))
        A = SIGMAS * rng.normal(size=(SIGHTINGS, 4, 7))
        way, phase = drawn(rng, 0.0003, 0.0005), rng.uniform(0.0, 2.0 * np.pi)
        bend = np.sin(2.0 * np.pi * rate * stamps + phase)[:, None] * way * (rate > 0.0)
        off = np.einsum("nri,ni->nr", A[:, :, 4:], bend) + rng.normal(size=(SIGHTINGS, 4))
        breath = ShaftBreath([slice(1, 7)])
        assert breath.heard(A, off, stamps) == (rate > 0.0)
        assert abs(breath.rate - rate) < 0.012
        bends = breath.bends(A, stamps).reshape(4 * SIGHTINGS, -1)
        left = off.ravel() - bends @ np.linalg.lstsq(bends, off.ravel(), rcond=None)[0]
        assert np.std(left) < 1.15 and (bends.any() == (rate > 0.0))
