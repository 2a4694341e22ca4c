"""Commands between receiver and tick, across threads."""

from __future__ import annotations

import sys
import threading

from surg_sim.nodes.command_box import CommandBox


def test_the_last_one_is_taken_once() -> None:
    box: CommandBox[int] = CommandBox()
    assert box.take() is None
    for value in (1, 2, 3):
        box.put(value)
    assert box.take() == 3
    assert box.take() is None


def test_a_late_simulator_makes_up_for_its_ticks_with_the_commands_that_came_meanwhile() -> None:
    box: CommandBox[int] = CommandBox()
    for value in range(1, 9):
        box.put(value)
    assert [box.take(behind) for behind in (5, 4, 3, 2, 1, 0)] == [3, 4, 5, 6, 7, 8]
    for value in (9, 10):
        box.put(value)
    assert [box.take(behind) for behind in (3, 2, 1, 0)] == [9, 10, None, None]


def test_two_threads_lose_nothing_that_is_new_and_see_nothing_twice() -> None:
    box: CommandBox[int] = CommandBox()
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
