"""Late commands to the assistant's instrument: told by the echoed stamp, never by a clock."""

from __future__ import annotations

import random
from types import SimpleNamespace

import numpy as np
import pytest

from surg_core.contract import TICK_NS
from surg_sim.nodes.command_echo import HISTORY, MAX_AGE, CommandEcho


def stamps(rng: random.Random, count: int) -> list[int]:
    """Of a loop on a real clock, which is set back or forth now and then."""
    now, found = 1_700_000_000_000_000_000, []
    for _ in range(count):
        now += TICK_NS + rng.randint(-90_000, 90_000)
        if rng.random() < 0.002:
            now += rng.choice((-1, 1)) * rng.randint(10**8, 10**12)
        found.append(now)
    return found


def test_what_answers_a_state_of_more_than_50_ticks_ago_is_late(
    rng: random.Random, full: bool
) -> None:
    runs, asked = 200 if full else 20, 0
    for _ in range(runs):
        given = stamps(rng, rng.randint(1, 2 * HISTORY))
        echo = CommandEcho()
        for stamp in given:
            echo.record(stamp)
        for _ in range(50):
            age = rng.randrange(min(len(given), HISTORY))
            meant = given[-1 - age] + rng.choice((0, TICK_NS))
            if given.count(meant) + given.count(meant - TICK_NS) > 1:
                continue  # a clock that was set back gave it twice
            assert echo.is_late(meant) == (age > MAX_AGE), f"{age} ticks"
            asked += 1
    print(f"{runs} runs, {asked} commands")


def test_a_stamp_of_another_clock_is_not_late(rng: random.Random) -> None:
    echo = CommandEcho()
    given = stamps(rng, 500)
    for stamp in given:
        echo.record(stamp)
    assert not echo.is_late(0)
    for stamp in given:
        assert not echo.is_late(stamp + 1)
        assert not echo.is_late(stamp - 7_000_000_000_000_000)


def test_a_stall_is_refused_and_what_is_sent_after_it_is_obeyed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The topics' own callbacks with a bridge in free-run and in lock-step."""
    node = pytest.importorskip("surg_sim.nodes.assistant_topics_node")
    callbacks, warned = {}, []
    monkeypatch.setattr(node.rospy, "Subscriber", lambda t, k, c, **_: callbacks.update({t: c}))
    monkeypatch.setattr(node.rospy, "logwarn_throttle", lambda _, text: warned.append(text))
    output = SimpleNamespace(connections=0)
    monkeypatch.setattr(node, "BytesPublisher", lambda *_: output)

    def message(tick: int, place: float) -> SimpleNamespace:
        layout = node.link_messages.JointStateLayout(["yaw", "pitch", "insertion", "roll"])
        data = layout.pack(0, tick * TICK_NS, np.full(4, place), np.zeros(0))
        return SimpleNamespace(data=data, _connection_header={"callerid": "/teleop"})

    for lockstep in (False, True):
        bridge = SimpleNamespace(lockstep=lockstep)
        got: list[tuple[int, object]] = []
        bridge.on_assistant = lambda a, who, stamp, what, value, got=got: got.append((stamp, value))
        topics = node.AssistantTopics(bridge)
        warned.clear()
        for tick in range(1, 201):
            topics.publish(tick, tick * TICK_NS, np.zeros(4), 0.0)
        for tick in (100, 149, 150, 200):  # meant for the tick after: of states 99, 148, 149, 199
            callbacks["/assistant/servo_jp"](message(tick, 0.1))
        taken = [value is not None for _, value in got]
        # A stamp may be of the state itself or of the tick after it: the benefit of the doubt.
        assert taken == ([True] * 4 if lockstep else [False, False, True, True])
        assert len(warned) == (0 if lockstep else 2)
        if not lockstep:
            assert warned[0] == (
                "/assistant/servo_jp from teleop: late: it answers a state of more than 0.1 s ago; "
                "not obeyed"
            )
