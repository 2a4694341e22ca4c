"""The lock-step state machine on a fake clock."""

from __future__ import annotations

import random

import pytest

from surg_sim.nodes.lockstep import Action, Lockstep


def book(**observers: int) -> Lockstep:
    return Lockstep(["PSM1", "PSM2"], ["op"], observers)


def answer_all(machine: Lockstep) -> None:
    machine.ready("op", machine.tick, False)
    for arm in ("PSM1", "PSM2"):
        for link in ("robot", "tool"):
            assert machine.answer(arm, link, machine.tick)


def test_a_tick_needs_every_link_of_every_arm() -> None:
    machine = book()
    assert not machine.may_step(), "before anything is published"
    machine.publish(1, 0.0)
    for arm, link in (("PSM1", "robot"), ("PSM1", "tool"), ("PSM2", "tool")):
        assert machine.answer(arm, link, 1)
        assert not machine.may_step()
    assert machine.answer("PSM2", "robot", 1)
    assert machine.may_step()
    machine.publish(2, 0.001)
    assert not machine.may_step()


def test_a_participant_once_heard_is_waited_for() -> None:
    """Its Ready may carry the end of the run, and may come after the controller's answer."""
    machine = Lockstep(["PSM1"], ["op"])
    for tick, heard in ((1, False), (2, True), (3, True)):
        machine.publish(tick, 0.0)
        machine.answer("PSM1", "robot", tick)
        machine.answer("PSM1", "tool", tick)
        assert machine.may_step() is (tick < 3)
        if heard:
            machine.ready("op", tick, tick == 3)
        assert machine.may_step()
    assert machine.finished()


def test_only_the_first_answer_to_the_present_tick_counts() -> None:
    machine = book()
    machine.publish(5, 0.0)
    assert not machine.answer("PSM1", "robot", 4)
    assert not machine.answer("PSM1", "robot", 6)
    assert machine.answer("PSM1", "robot", 5)
    assert not machine.answer("PSM1", "robot", 5)


def test_observers_have_a_window() -> None:
    machine = book(recorder=500)
    machine.publish(501, 0.0)
    answer_all(machine)
    assert not machine.may_step()
    assert "'recorder' is at tick 0, more than 500 behind" in "; ".join(machine.missing())
    machine.ready("recorder", 1, False)
    assert machine.may_step()
    machine.ready("recorder", 0, False)
    assert machine.may_step(), "an older Ready does not take the newer one back"


def test_asks_again_and_gives_up() -> None:
    machine = book()
    assert machine.poll(1e9) is Action.WAIT, "nothing is awaited yet"
    machine.publish(1, 100.0)
    actions = [(t, machine.poll(100.0 + t)) for t in (0.0, 1.9, 2.0, 2.1, 3.9, 4.0, 8.5, 9.9, 10.0)]
    assert [t for t, a in actions if a is Action.REPUBLISH] == [2.0, 4.0, 8.5]
    assert [t for t, a in actions if a is Action.ABORT] == [10.0]


def test_progress_starts_the_clock_anew() -> None:
    machine = book()
    machine.publish(1, 0.0)
    assert machine.poll(9.0) is Action.REPUBLISH
    machine.publish(2, 9.5)
    assert machine.poll(11.0) is Action.WAIT
    assert machine.poll(19.5) is Action.ABORT


def test_missing_names_everybody() -> None:
    machine = book()
    machine.publish(7, 0.0)
    machine.answer("PSM1", "robot", 7)
    machine.answer("PSM2", "robot", 7)
    machine.answer("PSM2", "tool", 7)
    text = "; ".join(machine.missing())
    assert "'op' has not sent Ready for tick 7" in text
    assert "PSM1 has not answered tick 7 with tool/servo_jp" in text
    assert "PSM2" not in text
    machine.ready("op", 7, False)
    assert "'op'" not in "; ".join(machine.missing())


def test_done_ends_the_run_with_the_last_participant() -> None:
    machine = Lockstep(["PSM1"], ["a", "b"])
    machine.publish(3, 0.0)
    machine.ready("a", 3, True)
    assert not machine.finished()
    machine.ready("b", 4, True)
    assert not machine.finished(), "b still wants tick 4"
    machine.publish(4, 0.0)
    assert machine.finished()
    assert not Lockstep(["PSM1"]).finished(), "nobody declared: runs until it is stopped"


def test_a_participant_that_runs_ahead_does_not_move_the_end() -> None:
    """It goes on saying Ready; the first tick with done is the last one, whoever is faster."""
    machine = Lockstep(["PSM1"], ["op"])
    machine.publish(4, 0.0)
    machine.ready("op", 4, False)
    machine.ready("op", 5, True)
    assert not machine.finished()
    machine.publish(5, 0.0)
    machine.ready("op", 6, True)
    machine.ready("op", 7, True)
    assert machine.finished()


@pytest.mark.parametrize("seed", range(20))
def test_any_order_of_arrival_gives_the_same_steps(seed: int) -> None:
    rng = random.Random(seed)
    machine = book(recorder=3)
    machine.publish(1, 0.0)
    for tick in range(1, 40):
        events = [(arm, link) for arm in ("PSM1", "PSM2") for link in ("robot", "tool")] * 2
        events += [("op", ""), ("recorder", "")]
        rng.shuffle(events)
        counted = 0
        for arm, link in events:
            if link:
                counted += machine.answer(arm, link, tick)
            else:
                machine.ready(arm, tick, False)
        assert counted == 4
        assert machine.may_step()
        machine.publish(tick + 1, 0.001 * tick)


def test_announced_commands_to_this_side_are_waited_for() -> None:
    """The assistant's commands go to the simulator: it holds them to what Ready has announced."""
    machine = Lockstep(["PSM1"], ["assistant", "op"], strict=True)
    machine.publish(1, 0.0)
    machine.answer("PSM1", "robot", 1)
    machine.answer("PSM1", "tool", 1)
    machine.ready("op", 1, False)
    assert not machine.may_step(), "strict: the assistant has not been heard of"
    machine.ready("assistant", 25, False, sent=2)
    assert not machine.may_step()
    machine.received("stranger")
    machine.received("assistant")
    assert not machine.may_step()
    assert "has sent the assistant 2 commands of which 1 arrived" in "; ".join(machine.missing())
    machine.received("assistant")
    assert machine.may_step()
    assert machine.missing() == []


def test_a_participant_may_be_ready_far_ahead() -> None:
    machine = Lockstep(["PSM1"], ["assistant"], strict=True)
    machine.ready("assistant", 25, False)
    for tick in range(1, 27):
        machine.publish(tick, 0.0)
        machine.answer("PSM1", "robot", tick)
        machine.answer("PSM1", "tool", tick)
        assert machine.may_step() is (tick <= 25)
