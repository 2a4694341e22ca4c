"""The age of messages that a network or a clock step delayed."""

import numpy as np
import pytest

from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import settings
from surg_core.hand.message_lateness import WINDOW, Arrivals
from surg_teleop.follow.teleop_types import CameraView, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders.bundled.crtk import CrtkLeader


def test_f03_messages_that_a_stall_held_up_are_as_old_as_they_are() -> None:
    """Random networks with stalls; the true time of arrival without the stall is the oracle."""
    worst, stalled = 0.0, 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        offset = rng.uniform(-1e6, 1e6)  # between the clocks
        delay, period = rng.uniform(0.0, 0.2), rng.choice([0.002, 0.033])
        arrivals, free, sent = Arrivals(), 0.0, 0.0
        stall = (rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.5))
        for _ in range(int(5.0 / period)):
            sent += period
            way = delay + rng.uniform(0.0, 0.01)
            held = stall[0] < sent + way < sum(stall)
            came = max(sum(stall) if held else sent + way, free)
            free = came
            found = arrivals.of(sent + offset, came)
            stalled += held
            assert found <= came
            worst = max(worst, abs(found - (sent + way)) if sent > 0.5 else 0.0)
    print(f"{stalled} messages held up; their age found within {1e3 * worst:.1f} ms")
    assert stalled > 10_000 and worst < 0.011  # the jitter of the way


def test_f09_no_clock_that_is_set_makes_a_message_late() -> None:
    for step in (-3600.0, -1.0, -0.2, 0.2, 1.0, 3600.0):
        arrivals = Arrivals()
        for k in range(2000):
            now = 0.01 * k
            stamp = 1e9 + now + (step if k >= 1000 else 0.0)
            assert arrivals.of(stamp, now) == pytest.approx(now, abs=1e-6)


def test_f09_a_stamp_that_stands_still_makes_no_message_late() -> None:
    arrivals = Arrivals()  # a link that is lost: its controller goes on with the last state
    assert {arrivals.of(7.0, 0.002 * k) - 0.002 * k for k in range(3000)} == {0.0}


def test_a_way_that_stays_longer_is_taken_as_it_is() -> None:
    arrivals = Arrivals()
    ages = []
    for k in range(1000):
        sent = 0.01 * k
        came = sent + (0.3 if k >= 300 else 0.0)
        ages.append(came - arrivals.of(sent, came))
    assert max(ages[:300]) == 0.0
    assert min(ages[300:450]) == pytest.approx(0.3)
    assert max(ages[300 + int(2 * WINDOW / 0.01) + 1 :]) < 1e-9


def test_f03_a_leader_whose_messages_are_held_up_is_not_followed() -> None:
    """A stall of 0.3 s between leader and teleoperation: hold, and the burst engages nothing."""
    leader, arrivals, arm = CrtkLeader("far"), Arrivals(), GateArm()
    teleop = Teleop(settings(), scale=1.0)
    teleop.enable()
    sent: list[tuple[float, np.ndarray]] = []
    p, states, messages = np.zeros(3), [], []
    for k in range(1500):
        now = arm.tick * TICK
        stalls = 500 <= k < 650
        if k % 5 == 0:
            p = p + np.array([2e-4, 0.0, 0.0])
            sent.append((now, p))
        while sent and not stalls:
            stamp, place = sent.pop(0)
            at = arrivals.of(stamp + 1e6, now)
            if now - at > 0.1:
                leader.on_late(now, now - at)
            leader.on_pose(at, place, np.array([0.0, 0.0, 0.0, 1.0]))
        out = teleop.tick(now, leader.read(now), arm.view(), CameraView(np.eye(3)))
        states.append(out.state)
        messages.append(out.message)
        arm.step(out.commands)
    assert states[499] is TeleopState.FOLLOWING
    waits = states.index(TeleopState.WAITING, 500)
    assert waits - 500 <= 51
    assert set(states[waits:]) == {TeleopState.WAITING}  # an act is needed
    assert arm.refusals == []
