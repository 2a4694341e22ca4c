"""What the tick leaves out because it would change nothing: the same numbers as doing it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from helpers.sim.phantom import Phantom
from surg_sim.physics.assistant_arm import Assistant, AssistantCommand
from surg_sim.physics.sim_arm import evenly
from surg_sim.physics.stability import all_finite
from surg_sim.physics.trocar_motion import MovingPoint, Sinusoid


def test_all_finite_is_the_check_of_every_number() -> None:
    rng = np.random.default_rng(3)
    counts = {True: 0, False: 0}
    odd = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, np.finfo(float).max, -0.0, 5e-324])
    for _ in range(5000):
        values = rng.normal(size=int(rng.integers(1, 140))) * 10.0 ** rng.integers(-300, 300)
        for place in rng.integers(0, len(values), int(rng.integers(0, 4))):
            values[place] = rng.choice(odd)
        expected = bool(np.isfinite(values).all())
        assert all_finite(values) is expected
        counts[expected] += 1
    assert min(counts.values()) > 500, counts
    print(f"{counts[True]} finite, {counts[False]} not")


@pytest.mark.parametrize(
    "indices", [[3], [0, 1, 2], [4, 6, 8, 10], [2, 1], [0, 1, 3], [5, 5], [7, 3, 9]]
)
def test_evenly_takes_and_writes_the_same_places(indices: list[int]) -> None:
    values = np.arange(12.0)
    np.testing.assert_array_equal(values[evenly(indices)], values[np.array(indices)])
    one, other = values.copy(), values.copy()
    one[evenly(indices)] = other[np.array(indices)] = -np.arange(len(indices))
    np.testing.assert_array_equal(one, other)


def test_a_point_at_rest_is_where_adding_nothing_would_put_it() -> None:
    """Against a point worked out anew in every tick, bit by bit, through moves and jumps."""
    rng = np.random.default_rng(8)
    still = 0
    for _ in range(40):
        start = rng.normal(size=3) * np.array([1.0, 0.0, -0.0])
        point, centre, motion, began = MovingPoint(start), start, None, 1
        for tick in range(2, 300):
            before = point.p_B
            draw = rng.random()
            if draw < 0.01:
                motion = Sinusoid(0.005, 0.25, (0.0, 1.0, 0.2)) if rng.random() < 0.5 else None
                point.move(motion)
                centre, began = before, tick - 1
            elif draw < 0.02:
                offset = rng.normal(size=3)
                point.jump(offset)
                centre = centre + offset
            point.advance()
            offset, velocity = np.zeros(3), np.zeros(3)
            if motion is not None:
                offset, velocity = motion.at((tick - began) * 0.002)
            assert point.p_B.tobytes() == (centre + offset).tobytes()
            assert point.v_B.tobytes() == velocity.tobytes()
            assert point.observed(0) == (tick, point.p_B, point.v_B)
            still += point.p_B is before
    assert still > 1000


def test_an_assistant_at_rest_is_told_what_it_would_be_told(full: bool) -> None:
    """Against one that moves its targets in every tick, through commands and long rests."""
    phantom, rng = Phantom(), np.random.default_rng(5)
    one = phantom.assistant
    other = Assistant(phantom.model, mujoco.MjData(phantom.model))
    rested = 0
    for _ in range(20000 if full else 4000):
        if rng.random() < 0.003:
            joints = rng.uniform([-1.0, -1.0, 0.03, -3.0], [1.0, 1.0, 0.2, 3.0])
            command = AssistantCommand(joints, float(rng.uniform(0.0, 1.0)))
            one.accept(command)
            other.accept(command)
        other._resting = False
        rested += one._resting
        one.advance()
        other.advance()
        assert one.target.tobytes() == other.target.tobytes()
        assert one._data.ctrl.tobytes() == other._data.ctrl.tobytes()
        assert one.jaw_target == other.jaw_target
    assert rested > 100
