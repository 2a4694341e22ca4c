"""When the camera is exposed, with renderers of every speed on a clock of ticks."""

from __future__ import annotations

import numpy as np
import pytest

from surg_core.contract import GRID
from surg_sim.nodes.exposure_schedule import RENDER_TIMEOUT, ExposureSchedule

TICKS = 5000


def play(
    schedule: ExposureSchedule, takes: list[int], speaks: bool = True
) -> list[tuple[int, int]]:
    """A renderer that keeps the newest exposure only: the (exposed, begun) of what it draws.

    Args:
        schedule: Under test.
        takes: Ticks for which it draws each picture, in turn.
        speaks: Whether it says what it has drawn.
    """
    begun: list[tuple[int, int]] = []
    waiting: int | None = None
    until = 0
    for tick in range(1, TICKS):
        if tick == until and speaks:
            schedule.rendered(begun[-1][0])
        if schedule.due(tick):
            waiting = tick
        if waiting is not None and tick >= until:
            begun.append((waiting, tick))
            waiting, until = None, tick + takes[len(begun) % len(takes)]
    return begun


def test_in_lockstep_the_grid_is_exposed_whoever_draws() -> None:
    schedule = ExposureSchedule(wait_for_renderer=False)
    schedule.rendered(3)
    exposed = [tick for tick in range(TICKS) for _ in range(2) if schedule.due(tick)]
    assert exposed == sorted(2 * list(range(0, TICKS, GRID))), "also when it is asked again"


@pytest.mark.parametrize("seed", range(20))
def test_what_is_drawn_is_never_old(seed: int) -> None:
    """Once it has spoken, a renderer is shown the state of the tick at which it begins."""
    rng = np.random.default_rng(seed)
    takes = rng.integers(1, RENDER_TIMEOUT // 2, 50).tolist()
    begun = play(ExposureSchedule(wait_for_renderer=True), takes)
    first = 2  # nobody knows of a renderer until it has drawn
    assert len(begun) > TICKS // RENDER_TIMEOUT
    assert all(exposed == at for exposed, at in begun[first:])
    spacing = np.diff([exposed for exposed, _ in begun[first:]])
    expected = [max(GRID, takes[(k + first + 1) % 50]) for k in range(len(spacing))]
    assert spacing.tolist() == expected, "as soon as it is ready, and 20 times a second at most"


@pytest.mark.parametrize("takes", [5, 40, 3 * RENDER_TIMEOUT])
def test_a_renderer_that_says_nothing_is_shown_20_states_a_second(takes: int) -> None:
    schedule = ExposureSchedule(wait_for_renderer=True)
    exposed = [tick for tick in range(TICKS) if schedule.due(tick)]
    assert exposed == list(range(GRID, TICKS, GRID))
    begun = play(ExposureSchedule(wait_for_renderer=True), [takes], speaks=False)
    assert all(at - exposed < GRID for exposed, at in begun)


def test_a_renderer_that_has_gone_is_not_waited_for_longer_than_once() -> None:
    schedule = ExposureSchedule(wait_for_renderer=True)
    exposed = []
    for tick in range(1, TICKS):
        if schedule.due(tick):
            exposed.append(tick)
            if tick < 1000 or tick > 3000:
                schedule.rendered(tick)
    gaps = np.diff(exposed)
    print(f"{len(exposed)} exposures, longest gap {gaps.max()} ticks")
    assert (gaps > GRID).sum() == 1 and gaps.max() == RENDER_TIMEOUT


def test_a_renderer_slower_than_the_patience_still_has_newer_states() -> None:
    begun = play(ExposureSchedule(wait_for_renderer=True), [2 * RENDER_TIMEOUT + 7])
    assert len(begun) >= TICKS // (2 * RENDER_TIMEOUT + 7)
    assert all(at - exposed < GRID for exposed, at in begun)
