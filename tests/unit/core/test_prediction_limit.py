"""How well any causal filter can predict a stream of 30 Hz: the table of the design page."""

import re

import numpy as np
from scipy.optimize import linprog

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "design" / "set_points.md"
RATE = 30.0  # Hz
TAPS = 12
PASS = 3.0  # Hz
AHEAD = {"17": 1 / 60, "33": 1 / 30, "23": 1 / 30 - 0.010}  # s
GAINS = (1.0, 1.5, 2.0, 3.0, 4.0)


def least_error(ahead: float, gain: float) -> float:
    """Least error in the pass-band of a predictor whose gain beyond it is limited.

    Args:
        ahead: time to predict [s].
        gain: limit from PASS to RATE / 2.

    Returns:
        Largest |P - exp(j w ahead)| below PASS; complex sizes as polygons of 16 sides.
    """
    turns = np.exp(-2j * np.pi * np.arange(16) / 16)
    rows, bounds = [], []
    for hertz in np.linspace(0, RATE / 2, 90):
        w = 2 * np.pi * hertz
        inside = hertz <= PASS
        wanted = np.exp(1j * w * ahead) if inside else 0
        taps = np.exp(-1j * w * np.arange(TAPS) / RATE)
        for turn in turns:
            rows.append([*np.real(taps * turn), -1.0 if inside else 0.0])
            bounds.append(np.real(wanted * turn) + (0 if inside else gain))
    cost = [0.0] * TAPS + [1.0]
    free = [(None, None)] * TAPS + [(0, None)]
    return float(linprog(cost, A_ub=rows, b_ub=bounds, bounds=free, method="highs").x[-1])


def test_the_page_states_the_limit_of_a_prediction() -> None:
    text = PAGE.read_text("utf-8")
    for name, ahead in AHEAD.items():
        row = re.search(rf"^\| {name} \([^|]*\|(.*)\|$", text, re.MULTILINE)
        assert row, name
        stated = [float(value) for value in row.group(1).split("|")]
        found = [least_error(ahead, gain) for gain in GAINS]
        print(name, " | ".join(f"{value:.3f}" for value in found))
        np.testing.assert_allclose(stated, found, atol=0.002)
