"""What becomes of the pictures that a policy gets in a score card."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from surg_cli.host import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

from policy import sights
from policy.card_conditions import FULL, CardCondition

PICTURE = np.random.default_rng(0).integers(20, 230, (48, 64, 3), np.uint8)


def pictures(count: int) -> list[np.ndarray]:
    """Different ones."""
    rng = np.random.default_rng(1)
    return [rng.integers(0, 255, PICTURE.shape, np.uint8) for _ in range(count)]


def test_pictures_that_say_nothing_do_not_depend_on_the_scene() -> None:
    shown = [each for each in FULL if each.blind and each.eye not in (None, sights.as_taken)]
    assert len(shown) == 2
    for condition in shown:
        assert condition.eye is not None
        eye, other = (condition.eye(np.random.default_rng(3)) for _ in range(2))
        first = pictures(1)[0]
        a = [eye(p) for p in (first, *pictures(4)[1:])]
        b = [other(p) for p in (first, *pictures(9)[6:])]
        np.testing.assert_array_equal(a, b)
    replayed = sights.Replayed(pictures(3))
    found = [replayed(PICTURE) for _ in range(5)]
    np.testing.assert_array_equal(found, [*pictures(3), pictures(3)[2], pictures(3)[2]])


@pytest.mark.parametrize("condition", FULL, ids=lambda each: each.name)
def test_a_condition_repeats_and_leaves_the_picture_alone(condition: CardCondition) -> None:
    if condition.eye is None:
        return
    kept = PICTURE.copy()
    eyes = [condition.eye(np.random.default_rng(3)) for _ in range(2)]
    a, b = (eye(PICTURE) for eye in eyes)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(PICTURE, kept)
    assert a.shape == PICTURE.shape and a.dtype == np.uint8
    plain = condition.eye is sights.as_taken or condition.eye is sights.frozen
    assert plain == np.array_equal(a, PICTURE)


def test_less_light_is_a_share_and_a_smudge_hides_its_place_only() -> None:
    dark = sights.light(0.3)(np.random.default_rng(0))(PICTURE)
    assert np.abs(dark - 0.3 * PICTURE).max() <= 1.0
    large = np.kron(PICTURE, np.ones((5, 5, 1), np.uint8))
    changed = (sights.smudge(np.random.default_rng(0))(large) != large).any(axis=2)
    off = np.abs(sights.smudge(np.random.default_rng(0))(large).astype(int) - large).max(axis=2)
    assert changed.any() and 0.03 < (off > 20).mean() < 0.12
