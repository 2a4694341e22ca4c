"""When a participant acts and what it says Ready for, however messages interleave."""

from __future__ import annotations

import io
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

rospy = pytest.importorskip("rospy")

from surg_core.contract import GRID  # noqa: E402
from surg_msgs.msg import Cycle, Ready, TaskState  # noqa: E402
from surg_ros import participant as module  # noqa: E402
from surg_ros.byte_topics import on_grid  # noqa: E402
from surg_ros.participant import Participant, TickInputs  # noqa: E402

ARMS = ("PSM1", "PSM2")


class Output:
    """Keeps what a participant says."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.said: list[Ready] = []

    def send(self, data: bytes) -> None:
        self.said.append(Ready().deserialize(data))


@pytest.fixture(autouse=True)
def no_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BytesPublisher", Output)
    monkeypatch.setattr(module.rospy, "get_name", lambda: "/me")


def make(seen: list[TickInputs], answer: Any = False, **options: Any) -> Participant:
    def act(each: TickInputs) -> bool | None:
        seen.append(each)
        return answer(each) if callable(answer) else answer

    ports: Any = {arm: SimpleNamespace(sent=3, out={}) for arm in options.get("arms", ARMS)}
    return Participant(ports, act, **{"arms": ARMS, "listen": False, **options})


def test_every_tick_is_answered_once_in_order_whatever_the_interleaving() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        seen: list[TickInputs] = []
        node = make(seen, task=True)
        for tick in range(1, 61):
            parts = [("cycle", arm) for arm in ARMS] * int(rng.integers(1, 3))  # repeated states
            parts += [("task", "")] if tick % GRID == 0 else []
            for at in rng.permutation(len(parts)):
                kind, arm = parts[at]
                if kind == "cycle":
                    node.on_cycle(Cycle(tick=tick), arm)
                else:
                    node.on_task(TaskState(tick=tick))
        assert [each.tick for each in seen] == list(range(1, 61))
        assert [m.tick for m in node._ready.said] == list(range(2, 62))
        for each in seen:
            assert {arm: cycle.tick for arm, cycle in each.cycles.items()} == dict.fromkeys(
                ARMS, each.tick
            )
            assert (each.task.tick if each.task else 0) == (0 if each.tick % GRID else each.tick)
    assert node._ready.said[-1].participant == "me"
    assert list(node._ready.said[-1].sent) == [3, 3]


def test_a_deferred_answer_holds_ready_back() -> None:
    seen: list[TickInputs] = []
    node = make(seen, answer=None, arms=("PSM1",))
    node.on_cycle(Cycle(tick=1), "PSM1")
    assert len(seen) == 1 and node._ready.said == []
    node.ready()
    assert [m.tick for m in node._ready.said] == [2]


def test_after_done_it_only_says_ready() -> None:
    seen: list[TickInputs] = []
    node = make(seen, answer=lambda each: each.tick == 3, arms=("PSM1",))
    for tick in range(1, 10):
        node.on_cycle(Cycle(tick=tick), "PSM1")
    assert [each.tick for each in seen] == [1, 2, 3]
    assert [m.done for m in node._ready.said] == [False, False] + 7 * [True]
    assert [m.tick for m in node._ready.said] == list(range(2, 11)), "the others wait for it"


def test_without_arms_it_acts_on_the_grid() -> None:
    seen: list[TickInputs] = []
    node = make(seen, arms=(), task=True)
    for tick in (GRID, GRID + 3, 2 * GRID):
        node.on_task(TaskState(tick=tick))
    assert [each.tick for each in seen] == [GRID, 2 * GRID]
    assert [m.tick for m in node._ready.said] == [2 * GRID, 3 * GRID]


def test_on_the_grid_it_reads_and_answers_that_alone() -> None:
    """Meanwhile cycles wait in their sockets; Ready reaches up to the next tick of the grid."""
    seen: list[TickInputs] = []
    node, kind = make(seen, task=True, grid=True), on_grid(Cycle)
    taken = dict.fromkeys(ARMS, 0)

    def feed(arm: str) -> None:
        for tick in range(1, 2 * GRID + 1):
            data = io.BytesIO()
            Cycle(tick=tick, q=[0.5], source="me").serialize(data)
            node.on_cycle(kind().deserialize(data.getvalue()), arm)
            taken[arm] = tick

    threads = [threading.Thread(target=feed, args=(arm,), daemon=True) for arm in ARMS]
    for thread in threads:
        thread.start()
    for tick in (GRID, 2 * GRID):
        time.sleep(0.05)
        assert set(taken.values()) == {tick - GRID} and len(seen) == tick // GRID - 1
        node.on_task(TaskState(tick=tick))
    for thread in threads:
        thread.join(10.0)
    assert [each.tick for each in seen] == [GRID, 2 * GRID]
    assert [(c.tick, c.q, c.source) for c in seen[0].cycles.values()] == 2 * [(GRID, (0.5,), "me")]
    assert [m.tick for m in node._ready.said] == [2 * GRID, 3 * GRID]


def test_in_free_run_the_first_arms_cycles_count() -> None:
    seen: list[TickInputs] = []
    node = make(seen, lockstep=False)
    node._connected = True
    node.on_cycle(Cycle(tick=10), "PSM1")
    assert node.silent == ["PSM2"] and not seen
    node.on_cycle(Cycle(tick=990), "PSM2")  # its controller counts for itself
    for tick in (11, 12, 12):
        node.on_cycle(Cycle(tick=tick), "PSM1")
    assert [each.tick for each in seen] == [11, 12]
    assert seen[-1].cycles["PSM2"].tick == 990


def test_in_free_run_nothing_is_sent_before_the_connections_are_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[TickInputs] = []
    node = make(seen, arms=("PSM1",), lockstep=False)
    node.on_cycle(Cycle(tick=1), "PSM1")
    assert seen == []
    monkeypatch.setattr(node, "_missing", lambda: "")
    node.connect(1.0)
    node.on_cycle(Cycle(tick=2), "PSM1")
    assert [each.tick for each in seen] == [2]
