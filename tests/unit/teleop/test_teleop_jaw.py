"""The jaw follows the grip and never opens by an engagement."""

import numpy as np
import pytest

from helpers.teleop.hand import JAW
from surg_teleop.follow.jaw_follower import MET, SLOW, JawFollower
from surg_teleop.leaders.bundled.crtk import CrtkLeader


def test_a_grip_ends_with_a_silence_of_its_hand_and_not_before() -> None:
    """Behind one name another may sit by then; a device may say its grip only when it changes."""
    leader = CrtkLeader()
    one = np.array([0.0, 0.0, 0.0, 1.0])
    leader.on_pose(0.0, np.zeros(3), one)
    leader.on_grip(0.0, 0.2)
    for tick in range(1, 101):
        leader.on_pose(0.02 * tick, np.zeros(3), one)
    assert leader.read(2.0).grip == pytest.approx(0.2)
    leader.on_rate(2.5, np.zeros(3), np.zeros(3))
    assert leader.read(2.5).grip is None
    leader.on_grip(3.0, 0.3)  # topics overtake each other
    leader.on_pose(3.001, np.zeros(3), one)
    assert leader.read(3.001).grip == pytest.approx(0.3)


def test_f31_an_engagement_never_opens_the_jaw() -> None:
    ghost = JawFollower(JAW, 3.0, angle=0.1, grip=0.8)
    assert [ghost.tick(0.8, 0.002) for _ in range(1000)] == [0.1] * 1000
    # The hand opens by a tenth of its range: so does the jaw, slowly.
    angles = [ghost.tick(0.9, 0.002) for _ in range(1000)]
    assert angles[0] == pytest.approx(0.1 + SLOW * 0.002)
    assert angles[-1] == pytest.approx(0.1 + 0.07)
    # It closes towards the jaw until both have met, and leads it fast from then on.
    ghost.tick(0.1, 0.002)
    assert not ghost.met
    while not ghost.met:
        ghost.tick(0.1, 0.002)
    assert abs(ghost.angle - 0.07) <= MET
    before = ghost.angle
    assert ghost.tick(1.0, 0.002) == pytest.approx(before + 0.006)


def test_f31_what_the_hand_opened_and_closed_again_opens_nothing() -> None:
    ghost = JawFollower(JAW, 3.0, angle=0.0, grip=0.5)
    ghost.tick(1.0, 0.0)
    ghost.tick(0.5, 0.0)
    assert [ghost.tick(0.5, 0.002) for _ in range(100)] == [0.0] * 100


def test_f31_random_grips_never_open_more_than_the_hand() -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        grips = np.clip(np.cumsum(rng.normal(0.0, 0.1, 100)) + rng.uniform(), 0.0, 1.0)
        ghost = JawFollower(JAW, 3.0, angle=rng.uniform(0.0, 0.7), grip=grips[0])
        by_hand, by_jaw, before, angle = 0.0, 0.0, grips[0], ghost.angle
        for grip in grips:
            by_hand += 0.7 * max(0.0, grip - before)
            after = ghost.tick(grip, rng.uniform(0.0, 0.05))
            by_jaw += max(0.0, after - angle)
            before, angle = grip, after
            assert by_jaw <= by_hand + 1e-12
