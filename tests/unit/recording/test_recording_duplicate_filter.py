"""A second connection to one publisher doubles nothing and loses nothing."""

from __future__ import annotations

import random

import pytest

from helpers.results.recording_results import note
from surg_recording.episode.duplicate_filter import WINDOW_S, DuplicateFilter


def interleave(rng: random.Random, lanes: list[list[int]]) -> list[tuple[int, int]]:
    """The lanes' messages as (lane, message), each lane in its own order."""
    left = [list(lane) for lane in lanes]
    order = []
    while any(left):
        lane = rng.choice([i for i, lane in enumerate(left) if lane])
        order.append((lane, left[lane].pop(0)))
    return order


@pytest.mark.parametrize("headers", [True, False])
def test_every_message_is_kept_once_however_the_connections_interleave(
    rng: random.Random, headers: bool, full: bool
) -> None:
    families = 3000 if full else 300
    for _ in range(families):
        # Without a header only the content tells messages apart, and content repeats.
        sent = list(range(40)) if headers else [rng.randrange(3) for _ in range(40)]
        # A connection begins late and may end early; one of them is always there.
        lanes = [sent]
        for _ in range(rng.randrange(1, 3)):
            first = rng.randrange(40)
            lanes.append(sent[first : rng.randrange(first, 41)] if headers else sent[first:])
        duplicate_filter = DuplicateFilter()
        order = interleave(rng, lanes)
        kept = [
            message
            for n, (connection, message) in enumerate(order)
            if not duplicate_filter.is_duplicate(connection, message, n * 1e-3)
        ]
        assert sorted(kept) == sorted(sent)
        assert duplicate_filter.duplicates == sum(map(len, lanes)) - len(sent)
    how = "with" if headers else "without"
    note(f"two connections, {how} headers", families, "each message kept once")


def test_one_connection_may_say_the_same_again() -> None:
    duplicate_filter = DuplicateFilter()
    assert not any(duplicate_filter.is_duplicate(1, "hold", t) for t in range(10))


def test_what_comes_much_later_is_news_and_memory_is_bounded() -> None:
    duplicate_filter = DuplicateFilter()
    for k in range(20_000):
        assert not duplicate_filter.is_duplicate(1, k, k * 2e-3)
    assert len(duplicate_filter._recent) == len(duplicate_filter._by_key) <= WINDOW_S / 2e-3 + 1
    assert duplicate_filter.is_duplicate(2, 19_999, 40.0)
    assert not duplicate_filter.is_duplicate(2, 0, 40.0)
