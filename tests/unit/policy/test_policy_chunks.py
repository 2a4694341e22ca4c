"""Chunks over time: keyed by absolute steps, blended, asked for every few steps."""

import math

import numpy as np
import pytest

from helpers.policy.policy_server import spec
from surg_policy_client import Chunk, ChunkBlender, Observation, RecedingHorizon


def seen(step: int) -> Observation:
    return Observation({}, step, 0, 0, "", spec())


def test_the_newest_chunk_wins_without_decay() -> None:
    blender = ChunkBlender()
    blender.add(10, np.full((5, 2), 1.0))
    blender.add(12, np.full((5, 2), 2.0))
    assert blender.rows_from(10)[:, 0].tolist() == [1, 1, 2, 2, 2, 2, 2]
    assert blender.rows_from(15)[:, 0].tolist() == [2, 2]
    assert blender.rows_from(17).shape == (0, 0)


def test_weights_are_those_of_the_temporal_ensemble() -> None:
    decay = 0.3
    blender = ChunkBlender(decay)
    for i in range(3):
        blender.add(i, np.full((4, 1), float(i)))
    weights = [math.exp(-decay * n) for n in range(3)]
    assert blender.rows_from(2)[0, 0] == pytest.approx((weights[1] + 2 * weights[2]) / sum(weights))
    assert blender.rows_from(4)[0, 0] == pytest.approx((1 + 2 * weights[1]) / (1 + weights[1]))


def test_equal_predictions_stay_what_they_are(rng) -> None:
    """Predictions cut from one trajectory at whatever steps blend to that trajectory."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    for _ in range(200):
        truth = numbers.normal(size=(60, 5))
        blender = ChunkBlender(float(numbers.uniform(0, 2)))
        steps = sorted(int(s) for s in numbers.integers(0, 40, 6))
        for step in steps:
            blender.add(step, truth[step : step + 20])
        rows = blender.rows_from(steps[-1])
        assert len(rows) == 20
        assert np.allclose(rows, truth[steps[-1] : steps[-1] + 20], atol=1e-12)


def test_a_gap_ends_the_rows() -> None:
    blender = ChunkBlender()
    blender.add(0, np.zeros((2, 1)))
    blender.add(5, np.ones((2, 1)))
    assert len(blender.rows_from(0)) == 2
    assert len(blender.rows_from(3)) == 0
    assert len(blender.rows_from(5)) == 2


@pytest.mark.parametrize("decay", [-0.1, math.nan, math.inf])
def test_bad_decay_is_refused(decay: float) -> None:
    with pytest.raises(ValueError, match="decay"):
        ChunkBlender(decay)


def test_rows_of_another_width_are_refused() -> None:
    blender = ChunkBlender()
    blender.add(0, np.zeros((2, 5)))
    with pytest.raises(ValueError, match=r"\[K, A\]"):
        blender.add(1, np.zeros((2, 4)))


class Counting:
    """Answers with its own count of questions."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def act(self, observation: Observation) -> np.ndarray:
        self.asked.append(observation.step)
        return np.full((10, 5), float(len(self.asked)))


def test_a_policy_is_asked_every_few_steps_and_after_missed_ones() -> None:
    inner = Counting()
    horizon = RecedingHorizon(inner, every=4)
    horizon.reset("", None)
    answers = {step: horizon.act(seen(step)) for step in (0, 1, 2, 3, 4, 5, 11, 12, 15)}
    assert inner.asked == [0, 4, 11, 15]
    assert [step for step, answer in answers.items() if answer is None] == [1, 2, 3, 5, 12]
    chunk = answers[4]
    assert isinstance(chunk, Chunk)
    assert (chunk.step0, len(chunk.rows)) == (5, 10)
    horizon.reset("", None)
    assert horizon.act(seen(0)) is not None


def test_a_horizon_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="every"):
        RecedingHorizon(Counting(), every=0)
