"""Free-run: the way between two steps, and what a controller makes of it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import surg_core
from helpers.policy_bench import ARM, HOME, Bench, cell
from helpers.policy_results import note
from surg_core import Motion, MotionCommand
from surg_policy_bridge.arm import PERIOD, SECOND, TICK, ArmCommand, Target
from surg_policy_bridge.free_run import FreeRun
from surg_policy_bridge.playout import SEND, Piece


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
        np.arange(1, round(seconds * SECOND / PERIOD) + 30) * PERIOD / SECOND / seconds, 0, 1
    )
    return distance * (10 * u**3 - 15 * u**4 + 6 * u**5)


class Follower:
    """A controller with an ideal arm, at its own rate."""

    def __init__(self) -> None:
        arm = cell().arms[ARM]
        made = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
        made.set_rcm(arm.trocar.p_BRcm)
        self.q, self.qd = np.array(arm.robot.home), np.zeros(6)
        self.controller = made
        self.out = made.step(self.q, self.qd)
        for word in (surg_core.StateCommand.ENABLE, surg_core.StateCommand.HOME):
            assert made.request(word) == surg_core.Reason.NONE
        self.out = made.step(self.q, self.qd)

    def step(self, target: Target | None) -> float:
        """One cycle; returns the set-point's x."""
        commands = []
        if target is not None:
            q = surg_core.tip_quaternion(target.p, target.roll)
            commands = [MotionCommand(Motion.SERVO_CP, 1, p=target.p, rotation=q)]
        self.out = self.controller.step(self.q, self.qd, commands)
        assert not self.out.refused, self.out
        self.qd = np.array(self.out.qd_command)
        self.q = self.q + 0.002 * self.qd
        R_BR, p = self.controller.X_BR[:3, :3], self.controller.X_BR[:3, 3]
        return float((R_BR.T @ (np.array(self.out.p_set) - p))[0])


def overshoot(rows: np.ndarray, way: str) -> float:
    """How far the set-point passes the end of a motion [m]."""
    arm = Follower()
    start = Target(HOME, 0.0, 0.3)
    steps = [start, *targets(rows)]
    pieces = chained(steps, known=way == "chunk")
    xs = []
    for k, piece in enumerate(pieces):
        for tick in range(PERIOD // TICK):
            if way == "steps":
                target = steps[k + 1] if tick == 0 else None
            else:
                due = tick * TICK % SEND == 0
                target = piece.at((tick * TICK + SEND) / PERIOD) if due else None
            xs.append(arm.step(target))
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


def test_steps_are_played_a_period_later_at_125_hz() -> None:
    bench = Bench()
    bench.hello()
    bench.tick()
    assert bench.server.enable(True, bench.now) == ""
    free = FreeRun([ARM], bench.now)
    sent: list[tuple[int, Target]] = []
    begin, x = bench.now, 0.0
    answers: list[tuple[int, dict[str, int]]] = []
    while bench.now - begin < SECOND:
        bench.tick()
        step = free.observe(bench.now)
        if step is not None:
            bench.ping()
            bench.step = step
            seen = len(bench.of("OBS"))
            bench.observe()
            if len(bench.of("OBS")) > seen:
                answers.append((bench.now + 30_000_000, dict(bench.of("OBS")[-1].head)))
        if answers and bench.now >= answers[0][0]:
            head = answers.pop(0)[1]
            x += 1e-3
            rows = [np.array([x, 0, HOME[2], 0.0, 0.3])]
            bench.act(rows, first=head["step"] + 1, seq=head["seq"], stamp_ns=head["stamp_ns"])
        for target in free.play(bench.server, {ARM: bench.arm.view}, bench.now).values():
            sent.append((bench.now, target))
            bench.arm.obey(ArmCommand(servo=target))
        bench.now += TICK
    assert bench.server.state.value == "RUNNING", bench.server.reason
    assert bench.server.counters.late == 0 and bench.server.counters.accepted >= 18
    assert bench.server.counters.empty <= 1
    times, xs = np.array([t for t, _ in sent]), np.array([t.p[0] for _, t in sent])
    assert (np.diff(times)[1:] >= SEND).all() and len(sent) >= 110, len(sent)
    np.testing.assert_allclose(np.diff(xs[20:]), 1e-3 * SEND / PERIOD, rtol=1e-6)
    ages = bench.server.counters.obs_age.values
    assert set(ages) == {PERIOD}


def test_nothing_is_played_once_the_policy_is_stopped() -> None:
    bench = Bench()
    bench.start()
    free = FreeRun([ARM], bench.now)
    bench.observe()
    bench.act(np.array([bench.here(1e-3 * i) for i in range(1, 12)]), first=0)
    views = {ARM: bench.arm.view}
    assert free.play(bench.server, views, bench.now)
    bench.now += SEND
    bench.server.enable(False, bench.now)
    for _ in range(20):
        assert not free.play(bench.server, views, bench.now)
        bench.now += SEND
