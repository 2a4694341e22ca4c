"""Force feedback: passive against walls with delay, faded, limited; values in, values out."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import pytest

from helpers.force.haptics import Feedback, Haptics

DT = 1e-3
HANDS = {"soft": (150.0, 3.0, 0.25), "middle": (400.0, 6.0, 0.35), "stiff": (1000.0, 12.0, 0.5)}
"""Spring [N/m], damper [N s/m] and mass [kg] of a person's hand; assumed, after figures of arms."""
DEVICE = 0.3
"""Moving mass of the device [kg]; assumed."""
MOST = 12.0  # [N]
RESOLUTION = 1.5e-6  # [m] of the device's encoder; assumed
CASES = list(itertools.product(HANDS, (200.0, 800.0, 2000.0), (0.0, 0.010, 0.040)))


@pytest.fixture(scope="module")
def haptics(tmp_path_factory: pytest.TempPathFactory) -> Haptics:
    return Haptics(tmp_path_factory.mktemp("haptics"))


class Run(NamedTuple):
    """Places of the hand [m], and the energy that it has really put into the force [J]."""

    x: np.ndarray
    energy: np.ndarray
    force: np.ndarray

    def swing(self, begin: float, end: float) -> float:
        """Peak to peak between two times [m]."""
        return float(np.ptp(self.x[round(begin / DT) : round(end / DT)]))


def push(
    haptics: Haptics, hand: str, wall: float, delay: float, controlled: bool, seconds: float = 5.0
) -> Run:
    """A hand whose wish moves 20 mm into a wall within 0.6 s and stays; each way has the delay.

    The hand is integrated in steps of 0.1 ms, the force is held for 1 ms.
    """
    k, b, m = HANDS[hand]
    m += DEVICE
    n, late = round(seconds / DT), 2 * round(delay / DT)
    x, v, energy = -0.02, 0.0, 0.0
    channel, seen, rows = haptics.channel(30.0, MOST), [], []
    for i in range(n):
        seen.append(round(x / RESOLUTION) * RESOLUTION)
        force = max(-wall * max(seen[max(0, i - late)], 0.0), -MOST)
        if controlled:
            force = channel.step(force, seen[-1], DT)
        u = min(i * DT / 0.6, 1.0)
        wish = -0.02 + 0.04 * (10 * u**3 - 15 * u**4 + 6 * u**5)
        before = x
        for _ in range(10):
            v += (k * (wish - x) - b * v + force) / m * DT / 10
            x += v * DT / 10
        energy -= force * (x - before)
        rows.append((x, energy, force))
    return Run(*np.array(rows).T)


@pytest.mark.parametrize(("hand", "wall", "delay"), CASES)
def test_with_the_controller_no_wall_swings_and_none_gives_energy(
    haptics: Haptics, hand: str, wall: float, delay: float
) -> None:
    run = push(haptics, hand, wall, delay, True)
    early, middle, end = run.swing(1.0, 2.0), run.swing(2.5, 3.5), run.swing(4.0, 5.0)
    print(
        f"{hand} {wall:g} N/m {1e3 * delay:g} ms: swing {1e3 * early:.2f}, {1e3 * middle:.2f}, "
        f"{1e3 * end:.2f} mm, energy from {1e3 * run.energy.min():.2f} mJ, "
        f"{-run.force[4000:].mean():.2f} N at the end"
    )
    assert run.energy.min() > -1e-3
    assert middle <= early + 1e-5 and end <= middle + 1e-5
    assert end < 1.5e-3
    assert np.abs(run.force).max() <= MOST


def test_without_the_controller_walls_with_delay_swing(haptics: Haptics) -> None:
    growing = 0
    for hand, wall, delay in CASES:
        run = push(haptics, hand, wall, delay, False, 3.0)
        growing += run.swing(2.0, 3.0) > 5e-3 and run.energy.min() < -1.0
    print(f"{growing} of {len(CASES)} cases swing")
    assert growing >= 6


def test_a_wall_without_delay_feels_as_stiff_as_it_is(haptics: Haptics) -> None:
    """The spring of the hand against the wall's, in series: the controller takes nothing off."""
    for hand, (k, _, _) in HANDS.items():
        force = -push(haptics, hand, 800.0, 0.0, True).force[4000:].mean()
        assert force == pytest.approx(0.02 * k * 800.0 / (k + 800.0), rel=2e-3)


def test_the_observer_counts_what_a_hand_puts_in(haptics: Haptics) -> None:
    """A force of 3 N against 10 mm of way is 30 mJ, however the way is divided."""
    channel = haptics.channel(30.0, MOST)
    for x in np.cumsum(np.random.default_rng(1).uniform(0.0, 2e-4, 200)):
        assert channel.step(-3.0, float(x), DT) <= -3.0  # never less than the wall's
        last = float(x)
    assert channel.energy >= 3.0 * (last - 2e-4) - 1e-3


def held(feedback: Feedback, force: list[float], seconds: float = 1.0) -> Feedback:
    """Feedback that has been on for a while, the hand at rest."""
    for _ in range(round(seconds / DT)):
        feedback.step(np.array(force), 0.004, np.zeros(3), True, DT)
    return feedback


@pytest.mark.parametrize("cause", ["silent", "not allowed", "not a number"])
def test_the_force_is_gone_50_ms_after_anything_ends(haptics: Haptics, cause: str) -> None:
    """The last measurement was 4 ms old when the source fell silent: its age is what counts."""
    feedback = held(haptics.feedback(), [0.0, -3.0, 1.0])
    force = np.array([0.0, np.nan, 1.0]) if cause == "not a number" else np.array([0.0, -3.0, 1.0])
    sizes = []
    for i in range(60):
        age = i * DT if cause == "silent" else 0.0
        out = feedback.step(force, age, np.zeros(3), cause != "not allowed", DT)
        sizes.append(float(np.linalg.norm(out)))
    assert sizes[0] > 3.0 and sizes[49] == 0.0 and max(sizes[49:]) == 0.0
    assert np.diff(sizes).max() <= 0.0
    # Back again: slowly, never at once.
    back = [
        float(np.linalg.norm(feedback.step(np.array([0.0, -3.0, 1.0]), 0.0, np.zeros(3), True, DT)))
        for _ in range(600)
    ]
    assert back[0] < 0.01 and back[249] < 0.55 * back[-1] and back[-1] > 3.0


def test_a_hand_that_moves_on_feels_nothing_after_the_end(haptics: Haptics) -> None:
    """Not even the controller's damping, though it gave out energy before; none is kept."""
    feedback = held(haptics.feedback(), [5.0, 0.0, 0.0])
    x = 0.0
    for _ in range(20):  # the force pushes the hand ahead of itself: that costs energy
        x += 2e-5
        feedback.step(np.array([5.0, 0.0, 0.0]), 0.0, np.array([x, 0.0, 0.0]), True, DT)
    assert feedback.energy < 0.0
    for i in range(200):
        x += 2e-4 if i > 60 else 0.0
        out = feedback.step(np.array([5.0, 0.0, 0.0]), 0.0, np.array([x, 0.0, 0.0]), False, DT)
        assert i < 49 or out.tolist() == [0.0, 0.0, 0.0]
    assert feedback.energy <= 0.0


def test_size_and_rate_are_limited(haptics: Haptics) -> None:
    feedback = held(haptics.feedback(max_force=4.0, max_rate=100.0), [0.0, 0.0, 0.0])
    outs = [
        feedback.step(np.array([30.0, 40.0, 0.0]), 0.0, np.zeros(3), True, DT) for _ in range(80)
    ]
    sizes = np.linalg.norm(outs, axis=1)
    assert np.diff(sizes).max() <= 0.1 + 1e-9 and sizes.max() == pytest.approx(4.0)
    assert outs[-1] == pytest.approx([2.4, 3.2, 0.0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_hand_that_is_nowhere_feels_nothing(haptics: Haptics, bad: float) -> None:
    feedback = held(haptics.feedback(), [2.0, 0.0, 0.0])
    out = feedback.step(np.array([2.0, 0.0, 0.0]), 0.0, np.array([0.0, bad, 0.0]), True, DT)
    assert out.tolist() == [0.0, 0.0, 0.0] and feedback.gate == 0.0
