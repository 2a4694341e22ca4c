"""How well any causal filter can predict a stream of 30 Hz: the table of the design page."""

import re

import numpy as np
from scipy.optimize import linprog

from helpers.control.stream_table import LEAST_TREMOR
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


DELAYS = (5, 10, 15, 20, 30, 40)  # ms
BETWEEN = (1.05, 1.5, 2.0)


def least_tremor(delay: float, between: float) -> float:
    """Least gain at 8 to 12 Hz of any impulse response that samples pass on their way to the tip.

    Args:
        delay: of the pass-band [s].
        between: limit of the gain up to RATE / 2 outside both bands.

    Returns:
        The gain; NaN where no response keeps the pass-band.
    """
    turns = np.exp(-2j * np.pi * np.arange(16) / 16)
    step = 1 / RATE / 6
    t = (np.arange(int(0.3 / step)) + 0.5) * step
    rows, bounds = [], []
    for hertz in np.arange(0, 3 * RATE + 0.1, 0.5):
        off = abs(hertz - RATE * round(hertz / RATE))
        wanted, slack, limit = 0j, 0.0, 0.5
        if hertz <= PASS:
            wanted, limit = np.exp(-2j * np.pi * hertz * delay), 0.05 * min(hertz, 1)
        elif 8 <= hertz <= 12:
            slack, limit = 1.0, 0.0
        elif hertz <= RATE / 2:
            limit = between
        elif off <= PASS:  # images: a fifth of the speed of the motion itself
            limit = 0.2 * off / hertz
        response = np.exp(-2j * np.pi * hertz * t)
        for turn in turns:
            rows.append([*np.real(response * turn), -slack])
            bounds.append(np.real(wanted * turn) + limit)
    free = [(None, None)] * len(t) + [(0, None)]
    cost = [0.0] * len(t) + [1.0]
    found = linprog(cost, A_ub=np.array(rows), b_ub=bounds, bounds=free, method="highs")
    return float(found.x[-1]) if found.status == 0 else float("nan")


def test_the_page_states_how_late_a_filter_without_tremor_must_be() -> None:
    text = PAGE.read_text("utf-8").split("**How late a filter")[1]
    for delay in DELAYS:
        row = re.search(rf"^\| {delay} \|(.*)\|$", text, re.MULTILINE)
        assert row, delay
        stated = [float(value.replace("–", "nan")) for value in row.group(1).split("|")]
        found = [least_tremor(1e-3 * delay, gain) for gain in BETWEEN]
        print(delay, " | ".join(f"{value:.2f}" for value in found))
        np.testing.assert_allclose(stated, found, atol=0.02)
        if delay == 5:
            assert stated[BETWEEN.index(1.5)] == LEAST_TREMOR
