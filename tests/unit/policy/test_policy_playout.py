"""Free-run: the way between two steps, and what a controller makes of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from helpers.policy.led_arm import Follower
from helpers.policy.policy_bench import ARM, HOME, MS, Bench
from helpers.results.policy_results import note
from surg_core.contract import SECOND_NS, STEP_NS, TICK_NS
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.model_server import ServerState
from surg_policy_bridge.server.playout import SEND, Piece
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_bridge.server.step_clock import StepClock


def targets(values: np.ndarray) -> list[Target]:
    """Targets along x."""
    return [Target(HOME + np.array([v, 0, 0]), 0.0, 0.3) for v in values]


def chained(steps: list[Target], known: bool) -> list[Piece]:
    """Pieces from step to step; ``known``: the step after the next is known."""
    pieces, slope = [], np.zeros(5)
    for i in range(len(steps) - 1):
        beyond = steps[i + 2] if known and i + 2 < len(steps) else None
        pieces.append(Piece(steps[i], steps[i + 1], slope, beyond))
        slope = pieces[-1].slope
    return pieces


def test_pieces_go_through_their_ends_and_never_beyond(full: bool) -> None:
    rng = np.random.default_rng(4)
    shares = np.linspace(0.0, 1.0, 41)
    pieces = 0
    for _ in range(500 if full else 20):
        walk = np.cumsum(rng.normal(scale=5e-3, size=20) * rng.integers(0, 2, 20))
        steps = targets(walk)
        for known in (True, False):
            for piece, start, goal in zip(chained(steps, known), steps, steps[1:], strict=False):
                xs = np.array([piece.at(s).p[0] for s in shares])
                assert xs[0] == start.p[0] and xs[-1] == pytest.approx(goal.p[0], abs=1e-15)
                low, high = sorted((start.p[0], goal.p[0]))
                assert low - 1e-15 <= xs.min() and xs.max() <= high + 1e-15
                assert (np.diff(xs) * np.sign(goal.p[0] - start.p[0]) >= -1e-15).all()
                pieces += 1
    print(f"{pieces} pieces")


def test_the_speed_is_continuous_where_the_steps_are_known() -> None:
    way = 0.03 * (1 - np.cos(np.linspace(0, math.pi, 30)))
    pieces = chained(targets(way), known=True)
    for before, after in itertools.pairwise(pieces):
        out = (before.at(1.0).p[0] - before.at(1 - 1e-6).p[0]) / 1e-6
        into = (after.at(1e-6).p[0] - after.at(0.0).p[0]) / 1e-6
        assert out == pytest.approx(into, abs=2e-6)


def test_a_roll_goes_the_shorter_way() -> None:
    piece = Piece(Target(HOME, 3.1, 0.0), Target(HOME, -3.1, 0.0), np.zeros(5), None)
    assert 3.1 < piece.at(0.5).roll < 2 * math.pi - 3.1


# --- through the controller -----------------------------------------------------------------------


def minimum_jerk(distance: float, seconds: float) -> np.ndarray:
    """Positions on the grid, at rest at both ends."""
    u = np.clip(
        np.arange(1, round(seconds * SECOND_NS / STEP_NS) + 30) * STEP_NS / SECOND_NS / seconds,
        0,
        1,
    )
    return distance * (10 * u**3 - 15 * u**4 + 6 * u**5)


def overshoot(rows: np.ndarray, way: str) -> float:
    """How far the set-point passes the end of a motion [m]."""
    arm = Follower()
    start = Target(HOME, 0.0, 0.3)
    steps = [start, *targets(rows)]
    pieces = chained(steps, known=way == "chunk")
    xs = []
    for k, piece in enumerate(pieces):
        for tick in range(STEP_NS // TICK_NS):
            if way == "steps":
                target = steps[k + 1] if tick == 0 else None
            else:
                due = tick * TICK_NS % SEND == 0
                target = piece.at((tick * TICK_NS + SEND) / STEP_NS) if due else None
            xs.append(arm.step(target)[0])
    assert abs(xs[-1] - rows[-1]) < 2e-4, "it arrives"
    return max(xs) - rows[-1]


def test_a_stream_of_steps_overshoots_and_the_way_between_them_does_not() -> None:
    """60 mm in 0.9 s: the peak is 0.125 m/s, as the expert's hand."""
    rows = minimum_jerk(0.06, 0.9)
    found = {way: 1e3 * overshoot(rows, way) for way in ("steps", "one step", "chunk")}
    note(4, 1, f"{found['steps']:.2f} mm; {max(found['one step'], found['chunk']):.3f} mm")
    assert found["chunk"] < 0.5 * found["steps"]
    assert found["one step"] < found["steps"]


# --- the grid of real time ------------------------------------------------------------------------


class RealTime:
    """A policy that answers every observation after the same time, and what is sent to its arm.

    Args:
        row: Where the arm shall be at a grid time, (5,), by its number from the policy's begin.
        rows: Steps per answer.
        delay: Of the answers [ns].
    """

    def __init__(self, row: Callable[[int], np.ndarray], rows: int, delay: int) -> None:
        self.bench, self._row, self._rows, self._delay = Bench(), row, rows, delay
        self.bench.hello()
        self.bench.tick()
        assert self.bench.server.enable(True, self.bench.now) == ""
        self.begin = self.bench.now
        self._free = StepClock([ARM], self.begin)
        self._answers: list[tuple[int, dict[str, int]]] = []
        self.first: int | None = None
        """Grid time of the first observation."""
        self.sent: dict[int, Target] = {}
        """By the time [ns] since the begin."""

    @property
    def counters(self) -> Counters:
        """Of the server."""
        return self.bench.server.counters

    def play(self, seconds: float, delay: int | None = None) -> None:
        """Let time pass; the answers of this time may take longer or shorter."""
        self._delay = self._delay if delay is None else delay
        end = self.bench.now + round(seconds * SECOND_NS)
        while self.bench.now < end:
            self._tick()
            self.bench.now += TICK_NS

    def _tick(self) -> None:
        bench = self.bench
        bench.tick()
        step = self._free.observe(bench.now)
        if step is not None:
            bench.ping()
            bench.step, before = step, len(bench.of("OBS"))
            bench.observe()
            for seen in bench.of("OBS")[before:]:
                self.first = step if self.first is None else self.first
                self._answers.append((bench.now + self._delay, dict(seen.head)))
        while self._answers and bench.now >= self._answers[0][0]:
            assert self.first is not None
            head = self._answers.pop(0)[1]
            first = head["step"] + 1
            rows = [self._row(first + i - self.first) for i in range(self._rows)]
            bench.act(rows, first=first, seq=head["seq"], stamp_ns=head["stamp_ns"])
        for target in self._free.play(bench.server, {ARM: bench.arm.view}, bench.now).values():
            self.sent[bench.now - self.begin] = target
            bench.arm.obey(target.commands())

    def at_grid(self, behind: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """What was sent at grid times (every fourth: 125 Hz), and the rows of them, both (n, 5).

        From the end of the second step on: the first one may have been a period late.

        Args:
            behind: Or of so many grid times before.
        """
        assert self.first is not None
        begin = min(self.sent) // STEP_NS + 2
        steps = [time // STEP_NS for time in self.sent if time % STEP_NS == 0]
        steps = [step for step in steps if step >= begin]
        there = np.array([self.sent[step * STEP_NS].row for step in steps])
        return there, np.array([self._row(step - behind - self.first) for step in steps])


def curve(n: int) -> np.ndarray:
    """A motion of tip, roll and jaw at up to 50 mm/s, from rest."""
    s = 1.0 - math.cos(0.12 * max(n, 0))
    return np.array([*(HOME + np.array([0.02, -0.01, 0.005]) * s), 0.3 * s, 0.3 + 0.1 * s])


@pytest.mark.parametrize(("rows", "ms"), [(2, 20), (16, 4), (16, 20), (16, 48), (16, 60), (16, 90)])
def test_a_chunk_is_where_it_says_at_every_grid_time(rows: int, ms: int) -> None:
    """However long the answers take: that is what the steps behind the first are for."""
    run = RealTime(curve, rows, ms * MS)
    run.play(4.0)
    there, wanted = run.at_grid()
    late = int(ms > 50)  # the first step of every answer
    # The first answer begins a period late, and the next ones are joined to it.
    np.testing.assert_allclose(there[2 * late :], wanted[2 * late :], rtol=0, atol=1e-12)
    assert len(there) >= 18 and run.counters.empty <= 2 + late
    answers = len(run.bench.of("ACK"))
    # The first answer is taken whole: the arm has waited for it.
    assert run.counters.late == late * (answers - 1) and not run.counters.rejected
    assert set(run.counters.obs_age.values) <= {STEP_NS * (1 + late), STEP_NS * 2}
    times = np.array(list(run.sent))
    assert (np.diff(times)[1:] <= 2 * SEND).all(), "without a gap"


@pytest.mark.parametrize("ms", [4, 20, 48])
def test_single_steps_are_played_a_period_later(ms: int) -> None:
    run = RealTime(curve, 1, ms * MS)
    run.play(2.0)
    there, wanted = run.at_grid(behind=1)
    np.testing.assert_allclose(there, wanted, rtol=0, atol=1e-12)
    assert run.counters.late == 0 and run.counters.empty <= 2 and len(there) >= 9
    assert set(run.counters.obs_age.values) == {STEP_NS}


def test_single_steps_that_take_longer_than_a_period_are_late() -> None:
    run = RealTime(curve, 1, 60 * MS)
    run.play(1.0)
    assert not run.sent and run.counters.accepted == 0
    assert run.counters.late == len(run.bench.of("ACK")) > 15


def test_a_slow_answer_now_and_then_does_not_show() -> None:
    """The chunk of before is played until it comes."""
    rng = np.random.default_rng(8)
    run = RealTime(curve, 16, 20 * MS)
    for _ in range(30):
        run.play(0.1, delay=int(rng.choice([8, 20, 70, 130])) * MS)
    there, wanted = run.at_grid()
    np.testing.assert_allclose(there, wanted, rtol=0, atol=1e-12)
    assert run.counters.late > 10 and run.counters.empty <= 4
    speeds = np.diff([t.p[0] for t in run.sent.values()]) / np.diff(list(run.sent)) * SECOND_NS
    assert np.abs(speeds).max() < 0.07


def test_a_stream_begins_with_its_first_step() -> None:
    """1.8 mm a step: the second step alone would be no begin (2 mm)."""
    run = RealTime(lambda n: np.array([1.8e-3 * n, 0, HOME[2], 0.0, 0.3]), 16, 20 * MS)
    run.play(0.6)
    assert run.counters.accepted >= 9 and not run.counters.rejected
    there, wanted = run.at_grid()
    np.testing.assert_allclose(there, wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("ms", [40, 80, 100, 140])
def test_a_stream_begins_with_its_first_step_however_late_it_comes(ms: int) -> None:
    """The arm has waited for it: its later steps alone would be too far away to begin with."""
    run = RealTime(lambda n: np.array([1.5e-3 * n, 0, HOME[2], 0.0, 0.3]), 16, ms * MS)
    run.play(0.9)
    assert not run.counters.rejected and run.counters.accepted >= 9
    assert run.bench.server.state is ServerState.RUNNING
    first = next(iter(run.sent.values()))
    assert first.p[0] < 1.5e-3 + 1e-12, "from where the arm stood"
    there, wanted = run.at_grid()
    behind = ms // 50  # the next answers bring it up to its times
    np.testing.assert_allclose(there[behind:], wanted[behind:], rtol=0, atol=1e-6)


def lead(way: str) -> float:
    """How far ahead of row n the set-point is at grid time n, in the middle of a motion [s]."""
    arm, rows = Follower(), minimum_jerk(0.06, 1.5)
    steps = [Target(HOME, 0.0, 0.3), *targets(rows)]  # at grid time n: step n
    pieces, middle = chained(steps, known=True), 15
    for n in range(middle):
        for tick in range(STEP_NS // TICK_NS):
            if way == "lock-step":
                target = steps[n + 1] if tick == 0 else None
            else:
                target = (
                    pieces[n].at(tick * TICK_NS / STEP_NS) if tick * TICK_NS % SEND == 0 else None
                )
            x = arm.step(target)[0]
    speed = (rows[middle] - rows[middle - 2]) * SECOND_NS / (2 * STEP_NS)
    return float((x - steps[middle].p[0]) / speed)


def test_the_set_point_is_where_its_row_says_at_the_row_s_time() -> None:
    """In lock-step as in real time, so a policy meets the same arm in both."""
    found = {way: 1e3 * lead(way) for way in ("lock-step", "real time")}
    print(", ".join(f"{way} {ms:.1f} ms" for way, ms in found.items()))
    assert all(abs(ms) < 10 for ms in found.values())


def test_nothing_is_played_once_the_policy_is_stopped() -> None:
    bench = Bench()
    bench.start()
    free = StepClock([ARM], bench.now)
    bench.observe()
    bench.act(np.array([bench.here(1e-3 * i) for i in range(1, 12)]), first=0)
    views = {ARM: bench.arm.view}
    assert free.play(bench.server, views, bench.now)
    bench.now += SEND
    bench.server.enable(False, bench.now)
    for _ in range(20):
        assert not free.play(bench.server, views, bench.now)
        bench.now += SEND


def test_an_idle_clock_turns_at_the_rate_of_sending_and_misses_no_grid_time() -> None:
    """Nothing is played while no policy runs, nor while one that runs says nothing."""
    for running in (False, True):
        bench = Bench()
        if running:
            bench.start()
        begin = bench.now
        free, turns, observed = StepClock([ARM], begin), 0, []
        while bench.now < begin + SECOND_NS:
            step, turns = free.observe(bench.now), turns + 1
            if step is not None:
                observed.append(bench.now - begin - step * STEP_NS)
            assert not free.play(bench.server, {ARM: bench.arm.view}, bench.now)
            # As the node waits, after a turn that took half a millisecond.
            after = bench.now + MS // 2
            bench.now = after + (max(0, free.due() - after) // MS + 1) * MS
        assert turns <= SECOND_NS // SEND + SECOND_NS // STEP_NS
        assert len(observed) == 20 and max(observed) <= MS + MS // 2


def test_an_idle_clock_plays_what_arrives_from_the_next_grid_time_on() -> None:
    bench = Bench()
    bench.start()
    begin = bench.now
    free, views = StepClock([ARM], begin), {ARM: bench.arm.view}
    bench.observe()
    assert not free.play(bench.server, views, begin)
    bench.now += 45 * MS  # an answer ends the wait, and the clock turns
    bench.act(np.array([bench.here(1e-3 * i) for i in range(1, 12)]))
    assert not free.play(bench.server, views, bench.now)
    assert free.due() == begin + STEP_NS, "not a period of sending later"
    assert free.play(bench.server, views, free.due())
    assert free.due() == begin + 7 * SEND, "the grid of sending, whenever the clock turned before"
