"""A chunk that comes late is joined to what is being executed; one in time stays as it is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from helpers.policy.policy_bench import Bench
from surg_core.contract import STEP_NS
from surg_policy_bridge.server.chunk_queue import plan_shares

Rows = Callable[[int, np.ndarray], np.ndarray]
"""A policy: the chunk (K, 5) for a grid time and the command in force (5,)."""
SPEED = 1e-3
"""Of a straight way along x [m per step]."""


def played(policy: Rows, delay: int, steps: int) -> tuple[Bench, np.ndarray]:
    """What was executed of a policy that is asked at each step and answers some steps later.

    The first answer alone comes at once: an arm at rest would wait for it.

    Returns:
        The bench, and the executed targets (N, 5).
    """
    bench = Bench()
    bench.start()
    answers: list[tuple[int, np.ndarray, dict[str, int]]] = []
    for _ in range(steps):
        bench.ping()
        bench.tick()
        bench.observe()
        asked = bench.of("OBS")[-1].head
        due = bench.step + (delay if answers or bench.sent else 0)
        answers.append((due, policy(bench.step, bench.here()), dict(asked)))
        while answers and answers[0][0] <= bench.step:
            _, rows, of = answers.pop(0)
            bench.act(rows, first=of["step"] + 1, seq=of["seq"], stamp_ns=of["stamp_ns"])
        bench.execute()
        bench.now += STEP_NS
        bench.step += 1
    return bench, np.array([target.row for _, target in bench.sent])


def way(step: int, aside: float, count: int = 16) -> np.ndarray:
    """Rows of a straight way from a grid time on, and so far aside of it [m]."""
    rows = np.zeros((count, 5))
    rows[:, 0] = SPEED * (step + 1 + np.arange(count))
    rows[:, 1], rows[:, 2], rows[:, 4] = aside, 0.12, 0.3
    return rows


def aside(delay: int) -> np.ndarray:
    """How far aside the arm goes (N,) after one answer that lies 3 mm aside, as a share of it.

    From the last step before that answer on, as long as it counts; nothing new comes behind it.
    """

    def policy(step: int, held: np.ndarray) -> np.ndarray:
        return way(step, 3e-3 * (step == 6)) if step <= 6 else np.zeros((0, 5))

    bench, found = played(policy, delay, 7 + 12)
    assert not bench.server.counters.rejected
    np.testing.assert_allclose(found[:, 0], SPEED * np.arange(1, 20), rtol=0, atol=1e-6)
    return found[5 + delay :, 1] / 3e-3


@pytest.mark.parametrize("delay", [1, 2, 5, 11])
def test_a_late_chunk_takes_over_without_a_jump(delay: int) -> None:
    """Neither the command nor its velocity jumps."""
    found, rows = aside(delay), min(16 - delay, 12)  # those that are left, for 0.6 s at most
    steps = np.diff(found)
    assert found[0] == 0.0 and (steps > 0.0).all(), "without a swing"
    assert steps.max() < 2.6 / (rows + 1) and len(steps) == 13 - delay, "a hard change: 1"
    assert (np.diff(steps) < 0.0).all(), "soonest at once"
    assert delay > 2 or found[-1] > 0.97, "it has taken over"


def test_a_chunk_in_time_stays_as_it_is() -> None:
    np.testing.assert_array_equal(aside(0), [0.0, *[1.0] * 13])


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_late_chunks_that_agree_change_nothing(delay: int) -> None:
    bench, found = played(lambda step, held: way(step, 0.0), delay, 30)
    np.testing.assert_allclose(found[:, 0], SPEED * np.arange(1, 31), rtol=0, atol=1e-12)
    assert bench.server.counters.late >= 20 * delay


def test_a_chunk_that_is_late_as_a_whole_changes_nothing() -> None:
    def policy(step: int, held: np.ndarray) -> np.ndarray:
        return way(step, 0.0) if step < 6 else way(step, 3e-3, count=2)

    bench, found = played(policy, 2, 16)
    assert not found[:, 1].any() and bench.server.counters.late > 20
    assert not bench.server.counters.rejected


def test_behind_the_end_of_a_plan_its_last_row_goes_on() -> None:
    """The first answer has two rows, and the next comes when they have been played."""

    def policy(step: int, held: np.ndarray) -> np.ndarray:
        return way(step, 0.0, count=16 if step else 2)

    bench, found = played(policy, 2, 8)
    share = plan_shares(12)
    wanted = SPEED * (share[0] * 2 + (1 - share[0]) * 4)
    assert found[2, 0] == pytest.approx(wanted, abs=1e-12) and not bench.server.counters.rejected


def test_a_roll_goes_the_shorter_way() -> None:
    def policy(step: int, held: np.ndarray) -> np.ndarray:
        rows = way(0, 0.0)
        rows[:, 0], rows[:, 3] = 0.0, 0.0 if step < 12 else math.tau
        return rows

    bench, found = played(policy, 2, 30)
    away = np.array([math.remainder(roll, math.tau) for roll in found[:, 3]])
    np.testing.assert_allclose(away, 0.0, atol=1e-12)
    assert not bench.server.counters.rejected


def test_a_late_chunk_that_is_not_finite_changes_nothing() -> None:
    """Relative rows that add up to infinity are found in the server; the wire finds the others."""
    bench, _ = played(lambda step, held: way(step, 0.0), 2, 8)
    queued = [step.row for step in bench.server.steps.queue._steps.values()]
    bench.observe()
    head = bench.of("OBS")[-1].head
    rows = way(bench.step, 3e-3)
    rows[8, 1] = math.inf
    session = bench.server.session
    assert session is not None
    steps, sent = bench.server.steps, session.sent[head["seq"]]
    steps.splice(session, bench.step - 1, rows, head["seq"], sent, bench.server._views, bench.now)
    assert [step.row for step in steps.queue._steps.values()] == queued
    assert steps.last_rejected is not None


def test_a_policy_whose_answers_disagree_keeps_its_arm() -> None:
    """They lie 8 mm to either side in turn, 250 ms late: hard changes are refused, and pause it."""

    def policy(step: int, held: np.ndarray) -> np.ndarray:
        return way(step, 4e-3 * (-1) ** step if step > 8 else 0.0)

    bench, found = played(policy, 5, 60)
    assert bench.server.state.value == "RUNNING" and not bench.server.counters.rejected
    assert np.abs(np.diff(found[:, 1])).max() < 4e-3 and found[-1, 0] > 50 * SPEED
