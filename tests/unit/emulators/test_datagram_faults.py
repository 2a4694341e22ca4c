"""A bad network in one direction."""

from __future__ import annotations

import pytest

from surg_emulators.datagram_faults import MOST_HELD, DatagramChannel

COUNT = 20_000


def sent(channel: DatagramChannel, count: int = COUNT) -> list[int]:
    """Numbers of the datagrams that arrive, in their order."""
    return [
        int.from_bytes(data, "little")
        for number in range(count)
        for data in channel.pass_on(number.to_bytes(4, "little"))
    ]


def test_a_good_network_changes_nothing() -> None:
    assert sent(DatagramChannel()) == list(range(COUNT))


@pytest.mark.parametrize("share", [0.002, 0.05, 1.0])
def test_the_share_of_lost_datagrams(share: float) -> None:
    arrived = sent(DatagramChannel(loss=share))
    assert arrived == sorted(arrived)
    assert 1.0 - len(arrived) / COUNT == pytest.approx(share, rel=0.1, abs=0.001)


def test_duplicates_follow_at_once() -> None:
    arrived = sent(DatagramChannel(duplicate=0.1))
    assert sorted(set(arrived)) == list(range(COUNT))
    assert arrived == sorted(arrived)
    assert len(arrived) / COUNT == pytest.approx(1.1, abs=0.01)


def test_reordered_datagrams_come_after_the_next_one_and_none_is_lost() -> None:
    arrived = sent(DatagramChannel(reorder=0.1))
    assert len(arrived) >= COUNT - 1
    late = [at for at, number in enumerate(arrived[1:], 1) if number < arrived[at - 1]]
    assert len(late) / COUNT == pytest.approx(0.09, abs=0.015)
    assert all(arrived[at - 1] - arrived[at] == 1 for at in late)


def test_a_burst_is_lost_in_a_row_and_once() -> None:
    channel = DatagramChannel(burst=30)
    assert sent(channel, 100) == list(range(30, 100))


def test_a_stall_keeps_the_order_and_its_memory_is_bounded() -> None:
    channel = DatagramChannel(stalled=True)
    assert sent(channel, MOST_HELD + 500) == []
    channel.stalled = False
    assert len(channel.pass_on(b"next")) == MOST_HELD + 1
    assert channel.pass_on(b"next") == [b"next"]


def test_the_same_seed_gives_the_same_network() -> None:
    made = [DatagramChannel(seed, loss=0.1, reorder=0.1, duplicate=0.1) for seed in (5, 5, 6)]
    first, second, other = (sent(channel, 1000) for channel in made)
    assert first == second != other
