"""What came last, across threads."""

from __future__ import annotations

import sys
import threading

from surg_sim.nodes.latest_value import LatestValue


def test_the_last_one_is_taken_once() -> None:
    box: LatestValue[int] = LatestValue()
    assert box.take() is None
    for value in (1, 2, 3):
        box.put(value)
    assert box.take() == 3
    assert box.take() is None


def test_two_threads_lose_nothing_that_is_new_and_see_nothing_twice() -> None:
    box: LatestValue[int] = LatestValue()
    last = 20_000
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # they meet in every line
    try:
        writer = threading.Thread(target=lambda: [box.put(k) for k in range(1, last + 1)])
        writer.start()
        taken: list[int] = []
        while not taken or taken[-1] != last:
            value = box.take()
            if value is not None:
                taken.append(value)
        writer.join()
    finally:
        sys.setswitchinterval(before)
    print(f"{len(taken)} of {last} taken")
    assert taken == sorted(set(taken))
    assert box.take() is None
